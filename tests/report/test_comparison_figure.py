"""The figure of a comparison."""

from dataclasses import replace

import numpy as np
import pytest
from artists import drawn, labels_of, legend_of, panel_of

from planopt.report import draw_comparison, draw_traces
from planopt.report.comparison_figure import layout_of
from planopt.studies.comparison import comparison_rows


def looks_of(comparison):
    """The slots of the settings at the first tick, by cost-to-go."""
    return {s.setting.one.cost_to_go: s for s in layout_of(comparison).slots if s.x < 0.5}


def test_units_and_settings(comparison):
    """Every metric with its unit; every setting in the legend; shares end at their limits."""
    figure = drawn(draw_comparison(comparison))
    assert labels_of(figure) == {
        "horizon [steps]",
        "time to goal [s]",
        "steps connected [%]",
        "longest outage [m]",
        "objective gain by refinement [%]",
        "runs of 2 [count]",
        "step time [ms]",
    }
    assert legend_of(figure) == [
        "geodesic cost-to-go, planner auto",
        "connected cost-to-go, planner lattice",
    ]
    low, high = panel_of(drawn(draw_comparison(comparison)), "steps connected").get_ylim()
    assert -5.0 <= low < high <= 105.0


def test_means_and_intervals(comparison):
    """Marks at the means; bars to the interval's ends; none where no run arrived."""
    axes = panel_of(draw_comparison(comparison), "time to goal")
    shift = looks_of(comparison)["connected"].x
    marks = {
        tuple(np.round(container.lines[0].get_xydata()[0], 9)): container.lines[2][0]
        for container in axes.containers
    }
    assert len(marks) == 3
    bar = marks[round(1.0 + shift, 9), 60.5].get_segments()[0]
    np.testing.assert_allclose(bar[:, 1], [60.5 - 6.353, 60.5 + 6.353])


def test_stalled_and_step_times(comparison):
    """Counts of runs that did not arrive, and median with 95 % quantile in milliseconds."""
    figure = draw_comparison(comparison)
    stalled = panel_of(figure, "stalled")
    assert [bar.get_height() for bar in stalled.patches] == [0, 2, 0, 0]
    times = panel_of(figure, "step time")
    assert times.get_yscale() == "log"
    bars = [each.lines[2][0].get_segments()[0][:, 1] for each in times.containers]
    np.testing.assert_allclose(bars, [[12.5, 40.0]] * 4)


def test_constant_metrics_are_words(comparison):
    """A metric that is the same in every run has no panel but is listed; so are no stalled runs."""
    same = [replace(run, metrics={**run.metrics, "path_m": 70.0}) for run in comparison.runs]
    found = replace(comparison, runs=tuple(same), rows=tuple(comparison_rows(same)))
    figure = drawn(draw_comparison(found))
    assert "driven length [m]" not in labels_of(figure)
    assert any("driven length 70 m" in words for words in legend_of(figure))
    arrived = tuple(replace(run, exit_code=0) for run in same)
    assert "runs of 2 [count]" not in labels_of(draw_comparison(replace(found, runs=arrived)))


def test_unknown_metric_and_one_setting(comparison):
    """A metric without a name here is shown by its own; a run need not have it."""
    row = replace(comparison.rows[0], metric="heart_rate", mean=2.0, ci_low=None, ci_high=None)
    heat = replace(row, metric="motor_heat_w")
    lone = replace(comparison, runs=comparison.runs[:2], rows=(row, heat))
    figure = drawn(draw_comparison(lone))
    assert {"heart rate", "motor heat [W]"} <= labels_of(figure)


def with_traces(comparison, count):
    """Runs of two settings on `count` seeds, tr P some longer than others."""
    (first, *_) = comparison.runs
    steps = np.arange(9)
    runs = tuple(
        replace(
            first,
            horizon=horizon,
            seed=seed,
            traces={"trace_p": (2.0 + 0.1 * seed) * 0.5 ** (horizon * steps[: 9 - seed % 2])},
        )
        for horizon in (1, 2)
        for seed in range(count)
    )
    return replace(comparison, runs=runs, rows=tuple(comparison_rows(runs)))


def test_traces_are_means_over_runs_with_bands(comparison):
    """As far as all runs go; the band is the Student interval, and none from too few runs."""
    assert draw_traces(comparison) is None
    panel = panel_of(drawn(draw_traces(with_traces(comparison, 6))), "tr P")
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("steps driven [1]", "tr P [m²]")
    assert panel.get_yscale() == "log"
    starts = 2.0 + 0.1 * np.arange(6)
    half = 2.5706 * starts.std(ddof=1) / np.sqrt(6)
    for line, band, horizon in zip(panel.lines, panel.collections, (1, 2), strict=True):
        fall = 0.5 ** (horizon * np.arange(8))
        np.testing.assert_allclose(line.get_ydata(), starts.mean() * fall)
        corners = band.get_paths()[0].vertices[:, 1]
        assert corners.max() == pytest.approx(starts.mean() + half, rel=1e-4)
        assert corners.min() == pytest.approx((starts.mean() - half) * fall[-1], rel=1e-4)
    few = panel_of(drawn(draw_traces(with_traces(comparison, 3))), "tr P")
    assert len(few.lines) == 2 and not few.collections
