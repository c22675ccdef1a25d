"""The comparison as text."""

from dataclasses import replace

import numpy as np

from planopt.channel.calibration import reliability
from planopt.report import comparison_text, reliability_lines


def blocks_of(comparison) -> list[list[str]]:
    """Title, tables and reliability table, line by line."""
    return [block.splitlines() for block in comparison_text(comparison).split("\n\n")]


def test_exact_lines(comparison):
    """Every number, its unit, its order and its alignment; settings begin each block."""
    title, first, second, tail = blocks_of(comparison)
    assert " ".join(title).startswith("small: 8 runs in 3.2 s; means over runs")
    assert [" ".join(line.split()) for line in first[-4:]] == [
        "geodesic auto 10 2 0 60.5 (54.1 to 66.9) 90.0 2.0 -",
        "geodesic auto 1 2 2 - 90.0 2.0 -",
        "connected lattice 10 2 0 60.5 (54.1 to 66.9) 90.0 2.0 -",
        "connected lattice 1 2 0 51.5 (45.1 to 57.9) 90.0 2.0 -",
    ]
    assert [" ".join(line.split()) for line in second[-4:]] == [
        "geodesic auto 10 - - 87.5 1.23 12.5 40.0",
        "geodesic auto 1 - - 87.5 1.23 12.5 40.0",
        "connected lattice 10 - - 87.5 1.23 12.5 40.0",
        "connected lattice 1 - - 87.5 1.23 12.5 40.0",
    ]
    assert tail == reliability_lines(comparison.reliability, "steps", "seeds")


def test_lines_fit_a_terminal(comparison):
    """A hundred letters at most; one run has a mean without interval, and the title says so."""
    rows = [replace(row, metric=f"{row.metric} {n}") for n in range(9) for row in comparison.rows]
    long = replace(comparison.problem, name="long " * 30)
    text = comparison_text(replace(comparison, problem=long, rows=tuple(rows)))
    assert max(map(len, text.splitlines())) <= 100
    row = replace(comparison.rows[0], seeds=1, mean=61.25, ci_low=None, ci_high=None)
    title, table, *_ = blocks_of(replace(comparison, rows=(row,)))
    assert ["geodesic", "auto", "10", "2", "0", "61.2", "-"] in [line.split()[:7] for line in table]
    words = " ".join(title)
    assert "no intervals for fewer than 5" in words and "brackets" not in words


def test_reliability_lines():
    """One line a bin; intervals only from five groups on, marked where they miss the prediction."""
    count = 500
    predicted = np.where(np.arange(count) % 2 == 0, 0.8, 0.95)
    realised = np.where(np.arange(count) % 2 == 0, np.arange(count) % 20 < 10, True)
    few = reliability(predicted, realised, np.arange(count) % 4)
    *title, header, first, last = reliability_lines(few, "steps", "seeds")
    assert " ".join(title).endswith("no intervals for fewer than 5 seeds")
    lines = [first, last]
    assert header.split()[-1] == "observed"
    assert [line.split()[2:] for line in lines] == [
        ["0.85", "250", "2", "0.8000", "0.5000"],
        ["0.975", "250", "2", "0.9500", "1.0000"],
    ]
    many = reliability(predicted, realised, np.arange(count) // 20)
    *title, header, low, high = reliability_lines(many, "steps", "seeds")
    assert "intervals over seeds" in " ".join(title)
    assert header.endswith("95 % interval")
    assert low.endswith("*") and not high.endswith("*")
    assert reliability_lines((), "steps", "seeds") == []
