"""Mark the slowest fifth of the tests ``long``: ``make quick`` runs the others.

``tests/long_tests.txt`` names them, a test function a line. All tests run with ``make tests
TEST_OPTIONS=--record-long`` measure them again and write the file.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import pytest

LONG_TESTS = Path(__file__).parent / "long_tests.txt"
LONG_SHARE = 0.2
SECONDS = pytest.StashKey[dict[str, float]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that writes the list."""
    parser.addoption("--record-long", action="store_true", help=f"write {LONG_TESTS.name} anew")


def pytest_configure(config: pytest.Config) -> None:
    """Begin to add up times where they are asked for."""
    if config.getoption("--record-long"):
        config.stash[SECONDS] = defaultdict(float)
        config.pluginmanager.register(Times(config.stash[SECONDS]))


class Times:
    """Adds up how long each test function takes, over its cases and with its fixtures."""

    def __init__(self, seconds: dict[str, float]) -> None:
        self._seconds = seconds

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Count one phase of one case."""
        self._seconds[function_of(report.nodeid)] += report.duration


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the list, where it was asked for, from the process that all reports come to."""
    seconds = session.config.stash.get(SECONDS, None)
    if seconds is None or hasattr(session.config, "workerinput"):
        return
    slowest = sorted(seconds, key=lambda name: -seconds[name])
    names = sorted(slowest[: round(LONG_SHARE * len(slowest))])
    LONG_TESTS.write_text("".join(f"{name}\n" for name in names), encoding="utf-8")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that the list names."""
    names = set(LONG_TESTS.read_text(encoding="utf-8").splitlines())
    for item in items:
        if function_of(item.nodeid) in names:
            item.add_marker(pytest.mark.long)


def function_of(node_id: str) -> str:
    """The name of a test function from that of one of its cases, below ``tests``."""
    return node_id.split("[")[0].removeprefix("tests/")
