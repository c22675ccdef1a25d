"""Results of every task agree with their references (:mod:`golden_cases`)."""

import pytest
from golden_cases import CASES, SHARE, differences, read_references, result

REFERENCES = read_references()


@pytest.mark.parametrize("name", CASES)
def test_golden_case(name: str) -> None:
    """The result is as its reference, except for a better verdict."""
    assert differences(REFERENCES[name], result(name)) == []


def test_every_reference_has_a_case() -> None:
    assert list(REFERENCES) == list(CASES)


@pytest.mark.parametrize(
    ("reference", "now", "words"),
    [
        ({"a": [1.0, 2.0]}, {"a": [1.0, 2.0 * (1.0 + 0.9 * SHARE)]}, []),
        ({"a": [1.0, 2.0]}, {"a": [1.0, 2.0 * (1.0 + 1.1 * SHARE)]}, ["a 1: 2.0 is now"]),
        ({"a": [1.0, 2.0]}, {"a": [1.0]}, ["a: [1.0, 2.0] is now [1.0]"]),
        ({"a": 1.0}, {}, ["a: 1.0 is now None"]),
        ({"a": 3}, {"a": 4}, ["a: 3 is now 4"]),
        ({"verdict": "violated"}, {"verdict": "verified"}, []),
        ({"verdict": "verified"}, {"verdict": "violated"}, ["verdict: verified is now"]),
    ],
)
def test_differences(reference: object, now: object, words: list[str]) -> None:
    """Numbers beyond the tolerance, other shapes, missing keys and worse verdicts are found."""
    found = differences(reference, now)
    assert len(found) == len(words)
    assert all(each.startswith(begin) for each, begin in zip(found, words, strict=True))
