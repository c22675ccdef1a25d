"""A comparison of horizons, costs to go and planners, a panel a metric."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planopt.report.metric_names import metric_name
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import MARKERS, SERIES, dress, head, legend_below, plain_log_ticks
from planopt.report.tables import interval_words
from planopt.studies.comparison import Comparison, Row

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

SPREAD = 0.6
"""Width that the settings of one horizon share, in distances between horizons."""

Setting = tuple[str | None, str]
"""Cost to go, None where there is no goal, and planner."""


@dataclass(frozen=True)
class Look:
    """How one setting is drawn: shift and width are in distances between horizons."""

    label: str
    colour: str
    marker: str
    shift: float
    width: float


def looks_of(comparison: Comparison) -> dict[Setting, Look]:
    """Looks of the settings, in the order of the rows: colour by cost to go, marker by planner."""
    settings = list(dict.fromkeys((row.cost_to_go, row.planner) for row in comparison.rows))
    costs = list(dict.fromkeys(cost for cost, _ in settings))
    planners = list(dict.fromkeys(planner for _, planner in settings))
    shifts = SPREAD * ((np.arange(len(settings)) + 0.5) / len(settings) - 0.5)
    return {
        (cost, planner): Look(
            label=f"planner {planner}" if cost is None else f"{cost} cost to go, planner {planner}",
            colour=SERIES[costs.index(cost) % len(SERIES)],
            marker=MARKERS[planners.index(planner) % len(MARKERS)],
            shift=float(shift),
            width=SPREAD / len(settings),
        )
        for (cost, planner), shift in zip(settings, shifts, strict=True)
    }


COLUMNS = 4
X_LABEL = "horizon [steps]"

RUN_SHIFT = 0.35
"""Single runs stand this share of a setting's width beside the mean."""

ROOM = 0.35
"""Room above and below the single runs, as a share of their range."""


def draw_comparison(comparison: Comparison) -> Figure:
    """Draw mean and interval of every metric by horizon, single runs as faint dots.

    Two more panels have the runs that did not reach the goal and the step times (median, and up
    to the 95 % quantile).
    """
    from matplotlib.gridspec import GridSpec

    rows = comparison.rows
    metrics = list(dict.fromkeys(row.metric for row in rows))
    looks = looks_of(comparison)
    places = {horizon: x for x, horizon in enumerate(sorted({row.horizon for row in rows}))}
    lines = math.ceil((len(metrics) + 2) / COLUMNS)
    figure = new_figure(4.0 * COLUMNS, 3.7 * lines + 0.8)
    cells = GridSpec(lines, COLUMNS, figure=figure)
    panels = [
        add_panel(figure, cells[number // COLUMNS, number % COLUMNS])
        for number in range(len(metrics) + 2)
    ]
    for panel, metric in zip(panels, metrics, strict=False):
        _draw_metric(panel, comparison, metric, places, looks)
    once = [row for row in rows if row.metric == metrics[0]]
    _draw_stalled(panels[-2], once, places, looks)
    entries = _draw_step_times(panels[-1], once, places, looks)
    for panel in panels:
        panel.set_xticks(list(places.values()), labels=[str(horizon) for horizon in places])
        panel.set_xlim(-0.5, len(places) - 0.5)
    legend_below(figure, entries, 4)
    head(
        figure,
        f"{comparison.problem.name}: {len(comparison.runs)} runs; mean, "
        f"{interval_words(comparison, 'cut at the frame')}, single runs faint",
    )
    return figure


def _draw_metric(
    panel: Panel,
    comparison: Comparison,
    metric: str,
    places: dict[int, int],
    looks: dict[Setting, Look],
) -> None:
    """Draw a metric: single runs, mean and interval where there is one."""
    name = metric_name(metric)
    values = [name.scale * run.metrics.get(metric, math.nan) for run in comparison.runs]
    for run, value in zip(comparison.runs, values, strict=True):
        look = looks[run.cost_to_go, run.planner]
        panel.plot(
            [places[run.horizon] + look.shift - RUN_SHIFT * look.width],
            [value],
            linestyle="none",
            marker=look.marker,
            markersize=4.0,
            color=look.colour,
            alpha=0.25,
            markeredgewidth=0.0,
        )
    for row in comparison.rows:
        if row.metric != metric or row.mean is None:
            continue
        look = looks[row.cost_to_go, row.planner]
        mean = name.scale * row.mean
        low = mean if row.ci_low is None else name.scale * row.ci_low
        high = mean if row.ci_high is None else name.scale * row.ci_high
        panel.errorbar(
            [places[row.horizon] + look.shift],
            [mean],
            yerr=[[mean - low], [high - mean]],
            marker=look.marker,
            markersize=7.0,
            markerfacecolor=look.colour,
            markeredgecolor="white",
            markeredgewidth=0.8,
            ecolor=look.colour,
            elinewidth=1.6,
            capsize=3.0,
            linestyle="none",
        )
    dress(panel, name.words, X_LABEL, f"{name.words} [{name.unit}]")
    known = [value for value in values if math.isfinite(value)]
    if known and min(known) < max(known):
        # Intervals over few runs are many times wider than the runs themselves.
        room = ROOM * (max(known) - min(known))
        panel.set_ylim(min(known) - room, max(known) + room)


def _draw_stalled(
    panel: Panel, rows: list[Row], places: dict[int, int], looks: dict[Setting, Look]
) -> None:
    """Draw how many runs of each setting did not reach the goal."""
    for (cost, planner), look in looks.items():
        mine = [row for row in rows if (row.cost_to_go, row.planner) == (cost, planner)]
        x = [places[row.horizon] + look.shift for row in mine]
        panel.bar(
            x,
            [row.stalled for row in mine],
            width=0.9 * look.width,
            color=look.colour,
            label=look.label,
        )
        # A zero has no bar: the marker tells it from a setting that was not run.
        panel.plot(
            x,
            [row.stalled for row in mine],
            linestyle="none",
            marker=look.marker,
            markersize=5.0,
            color=look.colour,
            markeredgecolor="white",
            clip_on=False,
        )
    most = max(row.seeds for row in rows)
    dress(panel, "stalled", X_LABEL, f"runs of {most} [count]")
    panel.set_yticks(np.unique(np.linspace(0, most, min(most, 6) + 1).round()))
    panel.set_ylim(0.0, 1.05 * most)


def _draw_step_times(
    panel: Panel, rows: list[Row], places: dict[int, int], looks: dict[Setting, Look]
) -> list[Artist]:
    """Draw median and 95 % quantile of the step time; the artists, for the legend."""
    entries: list[Artist] = []
    for (cost, planner), look in looks.items():
        mine = [row for row in rows if (row.cost_to_go, row.planner) == (cost, planner)]
        x = np.array([places[row.horizon] + look.shift for row in mine])
        median = 1e3 * np.array([row.p50_step_s for row in mine])
        slow = 1e3 * np.array([row.p95_step_s for row in mine])
        panel.errorbar(
            x,
            median,
            yerr=[np.zeros(len(mine)), slow - median],
            ecolor=look.colour,
            elinewidth=1.6,
            capsize=3.0,
            linestyle="none",
        )
        entries += panel.plot(
            x,
            median,
            linestyle="none",
            marker=look.marker,
            markersize=7.0,
            color=look.colour,
            markeredgecolor="white",
            markeredgewidth=0.8,
            label=look.label,
        )
    dress(panel, "step time: median, up to 95 % quantile", X_LABEL, "step time [ms]")
    panel.set_yscale("log")
    plain_log_ticks(panel.yaxis)
    return entries
