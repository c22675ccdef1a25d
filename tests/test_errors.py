"""Messages: one line that can be printed, whatever the input was."""

import pickle

import pytest
import refusals

from planopt import InputError, NoPlanError, OutputError
from planopt.errors import listed, printable


@pytest.mark.parametrize("kind", [InputError, OutputError, NoPlanError])
def test_messages_can_be_printed(kind: type[Exception]) -> None:
    """Half a surrogate pair, terminal codes and line breaks are escaped or joined."""
    text = str(kind("name \ud800 of\nline \x1b[2J two"))
    assert text == "name \\ud800 of line \\x1b[2J two"
    assert text.isprintable() and text.encode()


def test_long_names_and_messages_are_cut() -> None:
    """Their beginning and end remain, in file, key and remedy too."""
    assert printable("a" * 300) == "a" * 300
    cut = printable(f"key {'a' * 100_000}z: is wrong")
    assert len(cut) < 300 and cut.startswith("key aaa") and cut.endswith("aaz: is wrong")
    assert "..." in cut
    assert len(printable("word " * 10_000)) < 1300
    long = "x" * 50_000
    error = InputError(long, file=long, key=long, row=3, remedy=long)
    assert len(str(error)) < 1300
    for part in (error.message, error.file, error.key, error.remedy):
        assert part is not None and len(part) < 300


def test_errors_come_back_from_other_processes() -> None:
    error = InputError("is wrong", file="a.toml", key="robots", row=3, remedy="mend it")
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error) and vars(again) == vars(error)


def test_lists_of_names() -> None:
    """Those that fit, and how many more there are."""
    assert listed([]) == "none"
    assert listed(["a", "b"]) == "a, b"
    assert listed(str(i) for i in range(3000)) == ", ".join(map(str, range(12))) + " and 2988 more"
    assert len(listed(["n" * 10_000] * 3)) < 200


def test_the_table_of_messages_has_no_other_tests() -> None:
    """Entries of tests that were removed go with them."""
    assert [test for test in refusals.expected if not refusals.exists(test)] == []
