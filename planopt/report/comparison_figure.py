"""Figures of comparisons: metrics by horizon or swept key, and traces over time."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from planopt.arrays import Floats
from planopt.report.panel import (
    BAND,
    LABEL_PT,
    MARKERS,
    SERIES,
    TICK_PT,
    Panel,
    colour_of,
    dashed_look,
    draw_band,
    draw_intervals,
    dress,
    head,
    legend_below,
    log_scale,
    new_figure,
    plain_log_ticks,
)
from planopt.report.tables import BAND_ENDS, BANDS, interval_words, metric_label, metric_name
from planopt.studies.comparison import (
    Comparison,
    Setting,
    has_horizon,
    mean_interval,
    setting_words,
    short_keys,
    sweep_words,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

COLUMNS = 4

SPREAD = 0.6  # Total width of all settings at one tick, relative to the tick spacing
RUN_SHIFT = 0.35  # Offset of single runs from the mean, relative to the width of a setting
ROOM = 0.35  # Margin above and below the single runs, relative to their range
EDGE = 0.05  # Margin beyond zero and the largest possible value, relative to the range of the runs
WHOLE_RUN = "whole run"
"""Tick label of planners that optimise the whole run regardless of the horizon."""
NORMALISED = {"trace_p": "normalised_trace_p"}
"""Traces that get a second axis with their ratio to the initial value."""
LEGEND_WIDTH = 75  # Maximum line length of a setting in the legend, in characters
LOG_RATIO = 30.0  # Minimum ratio of largest to smallest mean for a logarithmic axis
LEAST_CHANGE = 0.01  # Minimum relative change of means for a trace to be drawn


@dataclass(frozen=True)
class Slot:
    """Position along the axis, label and style of a setting."""

    setting: Setting
    x: float  # In tick spacings
    width: float  # Width of this setting, in tick spacings
    label: str
    look: Mapping[str, Any]  # Colour and marker


@dataclass(frozen=True)
class Layout:
    """Positions of a comparison's settings along an axis, with ticks and label."""

    slots: tuple[Slot, ...]
    ticks: tuple[str, ...]
    label: str  # Axis label
    numbered: bool  # Whether ticks are setting numbers, because the swept keys differ


def layout_of(comparison: Comparison) -> Layout:
    """Return the layout of settings: by horizon, by a swept key, or numbered."""
    settings = comparison.settings
    names = short_keys(comparison.runs)
    horizons = {each.one.horizon for each in settings if has_horizon(each.one)}
    numbered = len({frozenset(each.one.sweep) for each in settings}) > 1
    key = None
    if not numbered and len(horizons) < 2:
        values = {key: {str(each.one.sweep[key]) for each in settings} for key in names}
        key = next((key for key, found in values.items() if len(found) > 1), None)
    places: list[object] = []
    series: list[tuple[str, str | None, str]] = []
    for number, one in enumerate((each.one for each in settings), start=1):
        horizon = one.horizon if has_horizon(one) else WHOLE_RUN
        places.append(number if numbered else horizon if key is None else str(one.sweep[key]))
        parts = [one.problem if comparison.others else "", sweep_words(one, key, names)]
        changed = ", ".join(part for part in parts if part)
        changed, cost = ("", None) if numbered else (changed, one.cost_to_go)
        series.append((changed, cost, one.planner))
    ticks = list(dict.fromkeys(places))
    if key is None:
        ticks.sort(key=lambda place: (isinstance(place, str), place))
    kinds = list(dict.fromkeys(each[:2] for each in series))
    planners = list(dict.fromkeys(planner for *_, planner in series))
    # Numbered settings have their own ticks and need no offset.
    distinct = list(dict.fromkeys(series))
    count = 1 if numbered else len(distinct)
    slots: list[Slot] = []
    for setting, place, (changed, cost, planner) in zip(settings, places, series, strict=True):
        rank = 0 if numbered else distinct.index((changed, cost, planner))
        words = (changed, "" if cost is None else f"{cost} cost-to-go", f"planner {planner}")
        colour = kinds.index((changed, cost)) if len(kinds) > 1 else planners.index(planner)
        slots.append(
            Slot(
                setting=setting,
                x=ticks.index(place) + SPREAD * ((rank + 0.5) / count - 0.5),
                width=SPREAD / count,
                label=", ".join(part for part in words if part),
                look={
                    "color": colour_of(colour),
                    "marker": MARKERS[planners.index(planner) % len(MARKERS)],
                },
            )
        )
    label = "setting" if numbered else "horizon [steps]" if key is None else key
    return Layout(tuple(slots), tuple(map(str, ticks)), label, numbered)


def draw_comparison(comparison: Comparison) -> Figure:
    """Draw mean and interval of every metric by horizon or swept key, single runs as faint dots.

    Metrics with the same value in every run are listed below. Two more panels show the runs that
    did not reach the goal, if any, and the step times (median and 95 % quantile).
    """
    layout = layout_of(comparison)
    shown = dict.fromkeys(row.metric for row in comparison.rows if row.mean is not None)
    metrics = [metric for metric in shown if metric not in BAND_ENDS]
    same: dict[str, float] = {}
    for metric in metrics:
        values = _finite(run.metrics.get(metric, math.nan) for run in comparison.runs)
        if len(values) > 1 and min(values) == max(values):
            same[metric] = values[0]
    metrics = [metric for metric in metrics if metric not in same]
    stalled = any(slot.setting.stalled for slot in layout.slots)
    count = len(metrics) + stalled + 1
    lines = math.ceil(count / COLUMNS)
    cells = [*range(count), *["."] * (lines * COLUMNS - count)]
    mosaic = [cells[COLUMNS * line : COLUMNS * (line + 1)] for line in range(lines)]
    figure, panels = new_figure(4.0 * COLUMNS, 3.7 * lines + 0.8, mosaic)
    for panel, metric in zip(panels, metrics, strict=False):
        _draw_metric(panel, layout, metric)
    if stalled:
        _draw_stalled(panels[-2], layout)
    entries = _draw_step_times(panels[-1], layout)
    for panel in panels:
        panel.set_xticks(np.arange(float(len(layout.ticks))), labels=list(layout.ticks))
        panel.set_xlim(-0.5, len(layout.ticks) - 0.5)
    words = [f"{n}: {w}" for n, w in enumerate(_setting_words(comparison), 1) if layout.numbered]
    if same:
        named = [(metric_name(key), value) for key, value in same.items()]
        equal = [f"{n.words} {n.scale * v:g} {n.unit}".removesuffix(" 1") for n, v in named]
        words.append("\n".join(textwrap.wrap(f"equal in all runs: {', '.join(equal)}", 110)))
    for line in words:
        entries += panels[-1].plot([], [], linestyle="none", label=line)
    legend_below(figure, entries, 4)
    intervals = interval_words(comparison, "as bars (clipped by the frame)")
    head(figure, f"{_title(comparison)}; means, {intervals}; faint dots: single runs")
    return figure


def _draw_metric(panel: Panel, layout: Layout, metric: str) -> None:
    """Draw a metric: single runs, mean, and interval if there is one."""
    name, known = metric_name(metric), list[float]()
    for slot in layout.slots:
        row, runs = slot.setting.rows.get(metric), slot.setting.runs
        values = name.scale * np.array([run.metrics.get(metric, math.nan) for run in runs])
        known += _finite(values.tolist())
        faint = {"linestyle": "none", "markersize": 4.0, "alpha": 0.25, "markeredgewidth": 0.0}
        x = np.full(len(runs), slot.x - RUN_SHIFT * slot.width)
        panel.plot(x, values, **faint, **slot.look)
        if metric in BANDS:
            ends = [slot.setting.rows.get(end) for end in BANDS[metric][:2]]
            low, high = (math.nan if end is None or end.mean is None else end.mean for end in ends)
            look = {"bottom": low, "width": slot.width, "color": BAND, "zorder": 0.5}
            panel.bar([slot.x], [high - low], **look)
        if row is not None and row.mean is not None:
            numbers = [row.mean, row.ci_low, row.ci_high]
            mean, low, high = name.scale * np.array(numbers, dtype=np.float64)
            _draw_mean(panel, slot, mean, low, high)
    title = name.words + (f"\ngrey: {BANDS[metric][-1]}" if metric in BANDS else "")
    dress(panel, title, layout.label, metric_label(metric))
    if known and min(known) < max(known):
        # Intervals over few runs are much wider than the range of the runs.
        least, most = min(known), max(known)
        room = ROOM * (most - least)
        end = EDGE * (most - least)
        low = max(least - room, -end) if least >= 0.0 else least - room
        panel.set_ylim(low, min(most + room, name.most + end))


def _draw_mean(panel: Panel, slot: Slot, value: float, low: float, high: float) -> Artist:
    """Draw a setting's mean with a bar from `low` to `high`; return a legend entry."""
    edge = {"markersize": 7.0, "markeredgecolor": "white", "markeredgewidth": 0.8}
    look = {"linestyle": "none", "label": slot.label, **edge, **slot.look}
    return draw_intervals(panel, [slot.x], [value], [low], [high], **look)


def _draw_stalled(panel: Panel, layout: Layout) -> None:
    """Draw the number of runs of each setting that did not reach the goal."""
    most = max(len(slot.setting.runs) for slot in layout.slots)
    for slot in layout.slots:
        stalled = float(slot.setting.stalled)
        panel.bar([slot.x], [stalled], width=0.9 * slot.width, color=slot.look["color"])
        # The marker shows a zero, which has no bar, unlike a setting that was not run.
        edge = {"markersize": 5.0, "markeredgecolor": "white", "clip_on": False}
        panel.plot([slot.x], [stalled], linestyle="none", **edge, **slot.look)
    dress(panel, "stalled", layout.label, f"runs of {most} [count]")
    panel.set_yticks(np.unique(np.linspace(0, most, min(most, 6) + 1).round()))
    panel.set_ylim(0.0, 1.05 * most)


def _draw_step_times(panel: Panel, layout: Layout) -> list[Artist]:
    """Draw median and 95 % quantile of the step time; return legend entries."""
    entries: list[Artist] = []
    for slot in layout.slots:
        # Runs without steps have NaN, which draws nothing.
        row = next(iter(slot.setting.rows.values()), None)
        times_s = (None, None) if row is None else (row.p50_step_s, row.p95_step_s)
        median, slow = 1e3 * np.array(times_s, dtype=np.float64)
        entries.append(_draw_mean(panel, slot, median, median, slow))
    dress(panel, "step time: median and 95 % quantile", layout.label, "step time [ms]")
    log_scale(panel, "y")
    return entries


def draw_traces(comparison: Comparison) -> Figure | None:
    """Draw quantities over time: the mean of each setting, and its 95 % interval as a band.

    Means are taken over the runs of a setting, up to the end of the shortest run. None if no run
    has a trace that changes.
    """
    tables = _trace_tables(comparison)
    if not tables:
        return None
    figure, panels = new_figure(11.0, 3.2 * len(tables) + 1.0, [[name] for name in tables])
    words = _setting_words(comparison)
    entries: list[Artist] = []
    for panel, (name, table) in zip(panels, tables.items(), strict=True):
        for number, traces in table.items():
            look = {**dashed_look(number // len(SERIES)), "color": colour_of(number)}
            along = np.arange(traces.shape[1], dtype=np.float64)
            entries += panel.plot(along, traces.mean(axis=0), label=words[number], **look)
            ends = [mean_interval(column, (0.0, math.inf)) for column in traces.T]
            low, high = np.array(ends, dtype=np.float64).T
            if np.isfinite(low).all():
                draw_band(panel, along, low, high, look["color"])
        dress(panel, metric_name(name).words, "steps driven [1]", metric_label(name))
        _scale_trace(panel, comparison, name, [traces.mean(axis=0) for traces in table.values()])
    legend_below(figure, entries, 2)
    head(figure, f"{_title(comparison)}; means, {interval_words(comparison, 'as bands')}")
    return figure


def _trace_tables(comparison: Comparison) -> dict[str, dict[int, Floats]]:
    """Return arrays (runs, steps) by trace and setting number, for traces that change."""
    tables: dict[str, dict[int, Floats]] = {}
    names = dict.fromkeys(name for run in comparison.runs for name in run.traces)
    for name in names:
        table: dict[int, Floats] = {}
        for number, setting in enumerate(comparison.settings):
            traces = [run.traces[name] for run in setting.runs if name in run.traces]
            if traces:
                steps = min(map(len, traces))
                table[number] = np.array([trace[:steps] for trace in traces])
        means = np.concatenate([traces.mean(axis=0) for traces in table.values()])
        changes = np.ptp(means) > LEAST_CHANGE * np.abs(means).max()
        if changes and name not in NORMALISED.values():
            tables[name] = table
    return tables


def _scale_trace(panel: Panel, comparison: Comparison, name: str, means: Sequence[Floats]) -> None:
    """Set the scale of a trace; add a normalised axis if all runs have one initial value."""
    low, high = min(map(np.min, means)), max(map(np.max, means))
    logarithmic = low > 0.0 and high >= LOG_RATIO * low
    if logarithmic:
        log_scale(panel, "y")
        panel.set_ylim(0.7 * low, 2.0 * high)
    other = NORMALISED.get(name)
    firsts = {float(run.traces[name][0]) for run in comparison.runs if other in run.traces}
    if other is None or len(firsts) != 1:
        return
    (first,) = firsts

    scales = partial(np.multiply, 1.0 / first), partial(np.multiply, first)
    right = panel.secondary_yaxis("right", functions=scales)
    right.set_ylabel(metric_label(other), fontsize=LABEL_PT)
    right.tick_params(labelsize=TICK_PT)
    if logarithmic:
        plain_log_ticks(right.yaxis)


def _finite(values: Any) -> list[float]:
    return [value for value in values if math.isfinite(value)]


def _title(comparison: Comparison) -> str:
    problems = ", ".join(one.name for one in (comparison.problem, *comparison.others))
    return f"{problems}: {len(comparison.runs)} runs"


def _setting_words(comparison: Comparison) -> list[str]:
    """Return the description of every setting, wrapped for the legend."""
    return ["\n".join(textwrap.wrap(each, LEGEND_WIDTH)) for each in setting_words(comparison)]
