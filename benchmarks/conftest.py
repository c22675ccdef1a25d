"""The table with ratios that a run of the benchmarks ends with."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

# Benchmarks compare with the planners of the examples.
sys.path.append(str(Path(__file__).parents[1] / "examples" / "planners"))

KEY = pytest.StashKey["Table"]()


class Table:
    """Durations of what was timed, by name and number of measurements."""

    def __init__(self) -> None:
        self._durations_s: dict[str, dict[int, Sequence[float]]] = {}
        self._notes: list[str] = []

    def add(self, name: str, count: int, durations_s: Sequence[float]) -> None:
        """Note durations in seconds."""
        self._durations_s.setdefault(name, {})[count] = durations_s

    def note(self, words: str) -> None:
        """Put a line below the table: a ratio to a peer, an error."""
        self._notes.append(words)

    def lines(self) -> list[str]:
        """The table as text; ratios are of medians, to the fewest measurements."""
        if not self._durations_s:
            return []
        width = max(len(name) for name in self._durations_s)
        lines = [f"{'':{width}}  measurements  runs  p50 [ms]  p95 [ms]  ratio"]
        for name, by_count in self._durations_s.items():
            first = np.median(by_count[min(by_count)])
            for count, durations_s in sorted(by_count.items()):
                p50, p95 = 1e3 * np.quantile(durations_s, [0.5, 0.95])
                lines.append(
                    f"{name:{width}}  {count:12}  {len(durations_s):4}  {p50:8.2f}  {p95:8.2f}  "
                    f"{p50 / 1e3 / first:5.2f}"
                )
        return lines + self._notes


def pytest_configure(config: pytest.Config) -> None:
    """Begin a table."""
    config.stash[KEY] = Table()


@pytest.fixture
def table(request: pytest.FixtureRequest) -> Table:
    """The run's table."""
    return request.config.stash[KEY]


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Print it."""
    for line in config.stash[KEY].lines():
        terminalreporter.write_line(line)
