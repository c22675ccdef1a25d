"""A comparison of horizons, costs to go and planners, a panel a metric."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import (
    BAND,
    LABEL_PT,
    MARKERS,
    SERIES,
    TICK_PT,
    dress,
    head,
    legend_below,
    plain_log_ticks,
)
from planopt.report.tables import BAND_ENDS, BANDS, interval_words, metric_name
from planopt.studies.comparison import Comparison
from planopt.studies.comparison_rows import (
    Row,
    has_horizon,
    mean_interval,
    runs_by_setting,
    setting_of,
    setting_words,
    short_keys,
    sweep_words,
)

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from matplotlib.artist import Artist
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from planopt.planning.run_summary import RunSummary

SPREAD = 0.6
"""Width that the settings of one horizon share, in distances between horizons."""

Setting = tuple[str, str | None, str]
"""Problem with what was changed of it, cost to go, None where there is no goal, and planner."""


@dataclass(frozen=True)
class Look:
    """The style of one setting: shift and width are in distances between horizons."""

    label: str
    colour: str
    marker: str
    shift: float
    width: float


WHOLE_RUN = "whole run"
"""Horizon of bounds, which foresee the run whatever it is."""


@dataclass(frozen=True)
class Axis:
    """The axis of the panels: the horizon, a swept key, or numbers of settings."""

    key: str | None  # The swept key; None for the horizon or numbers
    label: str  # With its unit
    several_problems: bool  # Whether series are told apart by problem
    names: Mapping[str, str]  # Short names of the swept keys
    # Of the settings, where these have different keys and stand side by side; else None
    numbers: Mapping[Hashable, int] | None = None

    def place(self, one: RunSummary | Row) -> Any:
        """Return where a run or row belongs."""
        if self.numbers is not None:
            return self.numbers[setting_of(one)]
        if self.key is not None:
            return one.sweep[self.key]
        return one.horizon if has_horizon(one) else WHOLE_RUN

    def ordered(self, rows: Sequence[Row]) -> list[str]:
        """Return all places in their order along the panels."""
        found = {str(self.place(row)): self.place(row) for row in rows}
        if self.key is not None:
            return list(found)
        return sorted(found, key=lambda words: (isinstance(found[words], str), found[words]))

    def setting(self, one: RunSummary | Row) -> Setting:
        """Return the series that a run or row belongs to."""
        if self.numbers is not None:
            return "", None, one.planner
        problem = [one.problem] if self.several_problems else []
        swept = sweep_words(one, self.key, self.names)
        return ", ".join([*problem, *([swept] if swept else [])]), one.cost_to_go, one.planner


def axis_of(comparison: Comparison) -> Axis:
    """Return what stands along the panels of a comparison."""
    rows = comparison.rows
    several, names = bool(comparison.others), short_keys(rows)
    if len({frozenset(row.sweep) for row in rows}) > 1:
        settings = dict.fromkeys(setting_of(row) for row in rows)
        numbers: dict[Hashable, int] = {each: n for n, each in enumerate(settings, start=1)}
        return Axis(None, "setting", several, names, numbers)
    if len({row.horizon for row in rows if has_horizon(row)}) < 2:
        for key in names:
            if len({str(row.sweep[key]) for row in rows}) > 1:
                return Axis(key, key, several, names)
    return Axis(None, "horizon [steps]", several, names)


def looks_of(comparison: Comparison) -> dict[Setting, Look]:
    """Looks of the settings, in the order of the rows.

    Colour by problem, what was changed and cost to go, if any of these differ; marker by planner,
    and colour as well else.
    """
    axis = axis_of(comparison)
    settings = list(dict.fromkeys(axis.setting(row) for row in comparison.rows))
    kinds = list(dict.fromkeys(setting[:2] for setting in settings))
    planners = list(dict.fromkeys(planner for *_, planner in settings))
    # Numbered settings have places of their own, and need none beside each other.
    count = 1 if axis.numbers is not None else len(settings)
    shifts = SPREAD * ((np.arange(count) + 0.5) / count - 0.5)
    return {
        (changed, cost, planner): Look(
            label=", ".join(
                part
                for part in (
                    changed,
                    "" if cost is None else f"{cost} cost to go",
                    f"planner {planner}",
                )
                if part
            ),
            colour=SERIES[
                (kinds.index((changed, cost)) if len(kinds) > 1 else planners.index(planner))
                % len(SERIES)
            ],
            marker=MARKERS[planners.index(planner) % len(MARKERS)],
            shift=float(shift),
            width=SPREAD / count,
        )
        for (changed, cost, planner), shift in zip(
            settings, np.resize(shifts, len(settings)), strict=True
        )
    }


COLUMNS = 4

RUN_SHIFT = 0.35
"""Single runs stand this share of a setting's width beside the mean."""

ROOM = 0.35
"""Room above and below the single runs, as a share of their range."""


def draw_comparison(comparison: Comparison) -> Figure:
    """Draw mean and interval of every metric by horizon or swept key, single runs as faint dots.

    Two more panels have the runs that did not reach the goal and the step times (median, and up
    to the 95 % quantile).
    """
    from matplotlib.gridspec import GridSpec

    rows = comparison.rows
    metrics = [m for m in dict.fromkeys(_shown(rows)) if m not in BAND_ENDS]
    looks, axis = looks_of(comparison), axis_of(comparison)
    places = {value: x for x, value in enumerate(axis.ordered(rows))}
    lines = math.ceil((len(metrics) + 2) / COLUMNS)
    figure = new_figure(4.0 * COLUMNS, 3.7 * lines + 0.8)
    cells = GridSpec(lines, COLUMNS, figure=figure)
    panels = [
        add_panel(figure, cells[number // COLUMNS, number % COLUMNS])
        for number in range(len(metrics) + 2)
    ]
    for panel, metric in zip(panels, metrics, strict=False):
        _draw_metric(panel, comparison, metric, places, axis, looks)
    once = list({setting_of(row): row for row in rows}.values())
    _draw_stalled(panels[-2], once, places, axis, looks)
    entries = _draw_step_times(panels[-1], once, places, axis, looks)
    for panel in panels:
        panel.set_xticks(list(places.values()), labels=list(places))
        panel.set_xlim(-0.5, len(places) - 0.5)
    if axis.numbers is not None:
        entries += _numbered(panels[-1], comparison)
    legend_below(figure, entries, 4)
    head(
        figure,
        f"{', '.join(one.name for one in (comparison.problem, *comparison.others))}: "
        f"{len(comparison.runs)} runs; mean, "
        f"{interval_words(comparison, 'cut at the frame')}, single runs faint",
    )
    return figure


def _shown(rows: Sequence[Row]) -> list[str]:
    """The metrics that a setting has."""
    return [row.metric for row in rows if row.mean is not None]


def _numbered(panel: Panel, comparison: Comparison) -> list[Artist]:
    """Return what numbers of settings mean, as entries of the legend without marks."""
    entries: list[Artist] = []
    names = short_keys(comparison.rows)
    for number, runs in enumerate(runs_by_setting(comparison.runs), start=1):
        words = _setting_words(comparison, runs[0], names)
        entries += panel.plot([], [], linestyle="none", label=f"{number}: {words}")
    return entries


DASHES = ("solid", "dashed", "dotted", "dashdot")

NORMALISED = {"trace_p": "normalised_trace_p"}
"""Traces that are others over their first value: a second axis of these."""

LEGEND_WIDTH = 75
"""Letters in a line of a setting's words."""

LOG_RATIO = 30.0
"""Traces whose means span this ratio or more have a logarithmic axis."""


def draw_traces(comparison: Comparison) -> Figure | None:
    """Draw what was known over time: each setting's mean, and its 95 % interval as a band.

    Means are over the runs of a setting, for as many steps as all of them drove. None where no run
    has a trace.
    """
    from matplotlib.gridspec import GridSpec

    every = [trace for run in comparison.runs for trace in run.traces.items()]
    names = [
        name
        for name in dict.fromkeys(name for name, values in every if (values > 0.0).any())
        if name not in NORMALISED.values()
    ]
    if not names:
        return None
    figure = new_figure(11.0, 3.2 * len(names) + 1.0)
    cells = GridSpec(len(names), 1, figure=figure)
    entries: list[Artist] = []
    for row, name in enumerate(names):
        panel = add_panel(figure, cells[row, 0])
        entries = _draw_trace(panel, comparison, name)
    legend_below(figure, entries, 2)
    problems = ", ".join(one.name for one in (comparison.problem, *comparison.others))
    words = interval_words(comparison, "bands, cut at the frame")
    head(figure, f"{problems}: {len(comparison.runs)} runs; mean, {words}")
    return figure


def _draw_trace(panel: Panel, comparison: Comparison, name: str) -> list[Artist]:
    """Draw one trace of all settings; the lines, for the legend."""
    entries: list[Artist] = []
    means: list[np.ndarray[Any, np.dtype[np.float64]]] = []
    names = short_keys(comparison.rows)
    for number, runs in enumerate(runs_by_setting(comparison.runs)):
        traces = [run.traces[name] for run in runs if name in run.traces]
        if not traces:
            continue
        steps = min(map(len, traces))
        along = np.arange(steps, dtype=np.float64)
        table = np.array([trace[:steps] for trace in traces])
        means.append(table.mean(axis=0))
        look = {"color": SERIES[number % len(SERIES)]}
        dashes = DASHES[number // len(SERIES) % len(DASHES)]
        label = _setting_words(comparison, runs[0], names)
        entries += panel.plot(along, means[-1], linestyle=dashes, label=label, **look)
        found = [mean_interval(column, (0.0, math.inf)) for column in table.T]
        bounds = [(low, high) for low, high in found if low is not None and high is not None]
        if len(bounds) == steps:
            low, high = np.array(bounds).T
            panel.fill_between(along, low, high, alpha=0.15, linewidth=0.0, **look)
    shown = metric_name(name)
    dress(panel, shown.words, "steps driven [1]", f"{shown.words} [{shown.unit}]")
    low, high = min(map(np.min, means)), max(map(np.max, means))
    logarithmic = low > 0.0 and high >= LOG_RATIO * low
    if logarithmic:
        panel.set_yscale("log")
        plain_log_ticks(panel.yaxis)
        panel.set_ylim(0.7 * low, 2.0 * high)
    right = _normalised_axis(panel, comparison, name)
    if logarithmic and right is not None:
        plain_log_ticks(right.yaxis)
    return entries


def _normalised_axis(panel: Panel, comparison: Comparison, name: str) -> Panel | None:
    """Add the axis of a trace over its first value, where this is the same in all runs."""
    other = NORMALISED.get(name)
    firsts = {float(run.traces[name][0]) for run in comparison.runs if other in run.traces}
    if other is None or len(firsts) != 1:
        return None
    (first,) = firsts
    shown = metric_name(other)

    def over_first(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return values / first

    def times_first(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return values * first

    right = panel.secondary_yaxis("right", functions=(over_first, times_first))
    right.set_ylabel(f"{shown.words} [{shown.unit}]", fontsize=LABEL_PT)
    right.tick_params(labelsize=TICK_PT)
    return right


def _setting_words(comparison: Comparison, run: RunSummary, names: Mapping[str, str]) -> str:
    """Say what a run is a setting of, in lines of a legend."""
    words = setting_words(run, names, several_problems=bool(comparison.others))
    return "\n".join(textwrap.wrap(words, LEGEND_WIDTH))


def _draw_metric(
    panel: Panel,
    comparison: Comparison,
    metric: str,
    places: dict[str, int],
    axis: Axis,
    looks: dict[Setting, Look],
) -> None:
    """Draw a metric: single runs, mean and interval where there is one."""
    name = metric_name(metric)
    values = [name.scale * run.metrics.get(metric, math.nan) for run in comparison.runs]
    for run, value in zip(comparison.runs, values, strict=True):
        look = looks[axis.setting(run)]
        panel.plot(
            [places[str(axis.place(run))] + look.shift - RUN_SHIFT * look.width],
            [value],
            linestyle="none",
            marker=look.marker,
            markersize=4.0,
            color=look.colour,
            alpha=0.25,
            markeredgewidth=0.0,
        )
    _draw_bands(panel, comparison, metric, places, axis, looks)
    for row in comparison.rows:
        if row.metric != metric or row.mean is None:
            continue
        look = looks[axis.setting(row)]
        mean = name.scale * row.mean
        low = mean if row.ci_low is None else name.scale * row.ci_low
        high = mean if row.ci_high is None else name.scale * row.ci_high
        panel.errorbar(
            [places[str(axis.place(row))] + look.shift],
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
    title = name.words
    if metric in BANDS:
        title += f"\ngrey: {BANDS[metric][-1]}"
    dress(panel, title, axis.label, f"{name.words} [{name.unit}]")
    known = [value for value in values if math.isfinite(value)]
    if known and min(known) < max(known):
        # Intervals over few runs are many times wider than the runs themselves.
        room = ROOM * (max(known) - min(known))
        panel.set_ylim(min(known) - room, max(known) + room)


def _draw_bands(
    panel: Panel,
    comparison: Comparison,
    metric: str,
    places: dict[str, int],
    axis: Axis,
    looks: dict[Setting, Look],
) -> None:
    """Draw the band that a metric should be in, behind each setting, where there is one."""
    if metric not in BANDS:
        return
    low, high, _ = BANDS[metric]
    rows = {(setting_of(row), row.metric): row.mean for row in comparison.rows}
    for row in comparison.rows:
        least, largest = (rows.get((setting_of(row), end)) for end in (low, high))
        if row.metric == metric and least is not None and largest is not None:
            look = looks[axis.setting(row)]
            panel.bar(
                [places[str(axis.place(row))] + look.shift],
                [largest - least],
                bottom=least,
                width=look.width,
                color=BAND,
                zorder=0.5,
            )


def _draw_stalled(
    panel: Panel,
    rows: list[Row],
    places: dict[str, int],
    axis: Axis,
    looks: dict[Setting, Look],
) -> None:
    """Draw how many runs of each setting did not reach the goal."""
    for setting, look in looks.items():
        mine = [row for row in rows if axis.setting(row) == setting]
        x = [places[str(axis.place(row))] + look.shift for row in mine]
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
    dress(panel, "stalled", axis.label, f"runs of {most} [count]")
    panel.set_yticks(np.unique(np.linspace(0, most, min(most, 6) + 1).round()))
    panel.set_ylim(0.0, 1.05 * most)


def _draw_step_times(
    panel: Panel,
    rows: list[Row],
    places: dict[str, int],
    axis: Axis,
    looks: dict[Setting, Look],
) -> list[Artist]:
    """Draw median and 95 % quantile of the step time; the artists, for the legend."""
    entries: list[Artist] = []
    for setting, look in looks.items():
        mine = [row for row in rows if axis.setting(row) == setting]
        x = np.array([places[str(axis.place(row))] + look.shift for row in mine])
        # Of runs without a step there are none, which draws nothing.
        median = 1e3 * np.array([row.p50_step_s for row in mine], dtype=float)
        slow = 1e3 * np.array([row.p95_step_s for row in mine], dtype=float)
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
    dress(panel, "step time: median, up to 95 % quantile", axis.label, "step time [ms]")
    panel.set_yscale("log")
    plain_log_ticks(panel.yaxis)
    return entries
