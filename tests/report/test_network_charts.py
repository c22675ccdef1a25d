"""Charts that compare runs of networks, and their step times."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from planopt.report.coverage_figure import draw_costs, draw_step_times


def test_costs_of_runs_are_drawn() -> None:
    """Each run is a line of its costs, named, in logarithms."""
    runs = {
        name: SimpleNamespace(times_s=np.arange(6.0), costs=scale * np.arange(5.0, 0.0, -1.0))
        for name, scale in (("law", 1.0), ("plan", 2.0))
    }
    axes = draw_costs(runs).axes[0]  # pyright: ignore[reportArgumentType]
    assert axes.get_yscale() == "log" and axes.get_xlabel() == "time [s]"
    for line, (name, run) in zip(axes.lines, runs.items(), strict=True):
        assert line.get_label() == name
        np.testing.assert_array_equal(line.get_xdata(), run.times_s[:-1])
        np.testing.assert_array_equal(line.get_ydata(), run.costs)


def test_step_times_are_drawn() -> None:
    """Each job is a line over the numbers of agents, both in logarithms."""
    axes = draw_step_times((10, 100), {"law": [0.1, 1.0], "plan": [0.2, 4.0]}).axes[0]
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert [list(line.get_ydata()) for line in axes.lines] == [[0.1, 1.0], [0.2, 4.0]]
    assert axes.lines[0].get_xdata().tolist() == pytest.approx([10.0, 100.0])
