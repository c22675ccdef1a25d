"""Differences of a saved document from the same document computed again."""

import math

import pytest

from planopt.files.compare import differences, digest, in_words, same_words


def keys(said: object, found: object) -> list[str]:
    return [difference.key for difference in differences(said, found)]


def test_every_leaf_is_compared() -> None:
    """Of tables in arrays in tables, each by its own key."""
    said = {"a": [{"b": 1.0, "c": "x"}, {"b": 2.0, "c": None}], "d": True}
    found = {"a": [{"b": 1.5, "c": "x"}, {"b": 2.0, "c": "y"}], "d": False}
    assert keys(said, said) == []
    assert keys(said, found) == ["a[0].b", "a[1].c", "d"]


def test_keys_of_one_alone() -> None:
    """A missing key and one too many are both disagreements; so is another length."""
    assert keys({"a": 1}, {"b": 1}) == ["b", "a"]
    assert keys({"a": [1, 2]}, {"a": [1]}) == ["a"]
    missing, unknown = differences({"a": 1}, {"b": 2})
    assert (missing.saved, missing.found) == ("is missing", "2")
    assert (unknown.saved, unknown.found) == ("1", "no such key")


@pytest.mark.parametrize(
    ("said", "found", "name", "agree"),
    [
        (1.0, 1.0 + 5e-7, "x_m", True),
        (1.0, 1.0 + 2e-6, "x_m", False),
        (1e6, 1e6 + 5e-4, "cost_m", True),
        (0.9, 0.9005, "connectivity", True),
        (0.9, 0.902, "connectivity", False),
        (-30.0, -30.02, "parameters", True),
        (-30.0, -30.05, "parameters", False),
        (3, 3.0, "horizon", True),
        (3, 4, "horizon", False),
        (10**400, 3, "horizon", False),
        (10**400, 10**400, "horizon", True),
        (True, 1, "horizon", False),
        (None, 0.0, "gap", False),
        (None, None, "gap", True),
        (math.nan, math.nan, "true_db", True),
        (math.nan, 1.0, "true_db", False),
        (math.inf, math.inf, "standard_errors", True),
        ("a", b"a", "fit_method", False),
        ({}, [], "robots", False),
    ],
)
def test_how_well_values_must_agree(said: object, found: object, name: str, agree: bool) -> None:
    """Exact numbers to a millionth, predictions and fits to a thousandth, labels wholly."""
    assert (keys({name: said}, {name: found}) == []) is agree
    assert (keys({name: found}, {name: said}) == []) is agree


@pytest.mark.parametrize(
    ("said", "found", "same"),
    [
        ("misses by 0.31 dB at step 3", "misses by 0.32 dB at step 3", True),
        ("misses by 0.31 dB at step 3", "misses by 0.33 dB at step 3", False),
        ("misses by 0.31 dB at step 3", "misses by 0.31 dB at step 4", False),
        ("misses by 0.31 dB", "meets by 0.31 dB", False),
        ("2 m", "1.999 m", True),
        ("1.2e-05 m", "1.3e-05 m", True),
        ("1.2e-05 m", "1.2e-04 m", False),
        ("1 and 2", "1 and 2 and 3", False),
    ],
)
def test_texts_with_numbers_in_them(said: str, found: str, same: bool) -> None:
    """Another machine may round the last shown digit otherwise; whole numbers are names."""
    assert same_words(said, found) is same


def test_few_of_many_alike_are_shown() -> None:
    """A wrong seed changes every row: three stand for all."""
    said, found = {"x": [0.0] * 9, "y": 1}, {"x": [1.0] * 9, "y": 2}
    words = in_words("run.json", differences(said, found))
    assert words == [
        "run.json, key x[0]: 0, recomputed 1",
        "run.json, key x[1]: 0, recomputed 1",
        "run.json, key x[2]: 0, recomputed 1",
        "run.json, key x[]: 6 more like these",
        "run.json, key y: 1, recomputed 2",
    ]


def test_wall_times_and_fallbacks_are_accepted() -> None:
    """But not in the tables of a problem."""
    said = {"planner": {"step_s": 1.0}, "rung": "plan", "robots": [{"wall_s": 1.0}]}
    found = {"planner": {"step_s": 2.0}, "rung": "stop", "robots": [{"wall_s": 9.0}]}
    assert keys(said, found) == []
    (difference,) = differences(said["planner"], found["planner"], accepted=frozenset())
    assert difference.key == "step_s"


def test_the_digest_covers_what_planning_alone_determines() -> None:
    """Every number below these keys, wherever they are; the problem has none of them."""
    data = {"seed": 1, "plans": [{"released": [{"x_m": [0.0, 1.5], "objective": 2.0}]}]}
    changed = {"seed": 1, "plans": [{"released": [{"x_m": [0.0, 1.5000001], "objective": 2.0}]}]}
    other = {"seed": 1, "plans": [{"released": [{"x_m": [0.0, 1.5], "objective": 3.0}]}]}
    assert digest(data) == digest(other) == digest({**data, "problem_file": {"x_m": 1}})
    assert digest(changed) != digest(data) != digest({**data, "seed": 2})


def test_rows_of_tables_are_named() -> None:
    """Counted from the header, as a text editor does."""
    words = in_words("steps.csv", differences({"x_m": [0.0, 1.0]}, {"x_m": [0.0, 2.0]}))
    assert words == ["steps.csv, row 3, key x_m: 1, recomputed 2"]


@pytest.mark.parametrize(("said", "found"), [("1.001", "1"), ("1.0", "1"), ("plan1", "plan")])
def test_labels_are_exact(said: str, found: str) -> None:
    """Only sentences have numbers that may be rounded otherwise."""
    assert keys({"connected": said}, {"connected": found}) == ["connected"]
    assert keys({"message": "least 0.701 at 3"}, {"message": "least 0.702 at 3"}) == []
