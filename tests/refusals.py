"""Error messages of planopt: the table ``error_messages.json`` contains each expected text once.

A test states only that something is refused: ``with refused(): load(path)``. The table lists the
tests of each message. To change messages, run the tests with ``--write-messages`` (not in parallel)
and review the difference of the table.
"""

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from planopt import InputError
from planopt.cli import main

TESTS = Path(__file__).parent
FILE = TESTS / "error_messages.json"
VARIABLE = (
    (r"/[^\s'\"]*?/pytest-\d+/(popen-gw\d+/)?[^/\s:,;'\")]+", "TMP"),
    (rf"{re.escape(str(TESTS.parent))}/", ""),
    (r"(?<=\.py, line )\d+", "N"),
    (r"(?<=[a-z]Error: ).*?(?= \([a-z][^()]*\)$|$)", "..."),
    (r"(?<=CasADi: )\.\.\..*|(?<=table: )Unable to.*", "..."),
    (r"0x[0-9a-f]{6,}", "0x..."),
    (r"([nx])\1{20,}\.\.\.\1+", r"\1..."),
    (r"(?<=while decoding a JSON )(array|object)", "..."),
    (r"(?<=,) '(corridor|doubled_for_bounds|sending)',| or (corridor|sending)", ""),
    (r"(?<=each_step, average, joint, outage, data)(, \w+)+(?= \()", ""),
    (r"line \d+ column \d+ \(char \d+\)", "line N"),
    (r"(?<=\d\.\d{3})\d{5,}", ""),
    (r"\(Possible options?: [^)]*\) ", ""),
)
"""Parts of messages that depend on the run, versions, registered terms and rules."""

recorded: dict[str, str] = {}
"""Messages of this session by test and number within the test."""

writing = False
"""The messages of this session replace those of the table."""


def read_table() -> dict[str, str]:
    table = json.loads(FILE.read_text(encoding="utf-8"))
    return {test: message for message, tests in table.items() for test in tests}


def function_of(test: str) -> tuple[Path, str]:
    """Return the file and the function of a test in the table."""
    file, _, name = test.partition("::")
    return TESTS / file, re.split(r"[\[ ]", name)[0]


def exists(test: str) -> bool:
    """Return whether a test of the table is there."""
    file, name = function_of(test)
    return file.exists() and f"\ndef {name}(" in file.read_text(encoding="utf-8")


def write_table() -> None:
    """Replace the messages of the tests that ran, and drop those of tests that are gone."""
    ran = {function_of(test) for test in recorded}
    kept = {k: v for k, v in expected.items() if function_of(k) not in ran and exists(k)}
    table: dict[str, list[str]] = {}
    for test, message in sorted({**kept, **recorded}.items()):
        table.setdefault(message, []).append(test)
    lines = (
        f"{json.dumps(message, ensure_ascii=False)}: {json.dumps(tests, ensure_ascii=False)}"
        for message, tests in sorted(table.items())
    )
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


expected = read_table()


@contextmanager
def refused(kind: type[Exception] = InputError) -> Iterator[pytest.ExceptionInfo[Any]]:
    """Expect an error with the message of the table."""
    with pytest.raises(kind) as caught:
        yield caught
    expect_message(str(caught.value))


def expect_message(text: str) -> None:
    for pattern, replacement in VARIABLE:
        text = re.sub(pattern, replacement, text)
    test = os.environ["PYTEST_CURRENT_TEST"].removesuffix(" (call)").removeprefix("tests/")[:300]
    count = next(i for i in range(1, 1000) if f"{test} {i}" not in recorded)
    recorded[f"{test} {count}"] = text.strip()
    if not writing:
        assert text.strip() == expected.get(f"{test} {count}"), "see tests/refusals.py"


def refused_command(capsys: pytest.CaptureFixture[str], *arguments: object) -> None:
    """Expect exit code 2, nothing else on stdout, and the line of the table on stderr."""
    assert main([str(argument) for argument in arguments]) == 2
    printed = capsys.readouterr()
    if "--json" in arguments:
        assert f"planopt: {json.loads(printed.out)['error']}\n" == printed.err
    else:
        assert printed.out == ""
    assert printed.err.startswith("planopt: ") and printed.err.count("\n") == 1
    assert printed.err.strip().isprintable() and len(printed.err) < 1500
    expect_message(printed.err)
