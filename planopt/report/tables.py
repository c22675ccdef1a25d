"""Comparisons, and predicted against true connection, as plain-text tables."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from itertools import zip_longest

from planopt.channel.validation.calibration import FEWEST_GROUPS, ReliabilityBin
from planopt.report.style import spaced
from planopt.studies.comparison import Comparison, Row, setting_of, sweep_words


@dataclass(frozen=True)
class MetricName:
    """How a metric is shown.

    Attributes
    ----------
    words
        Its name for people.
    unit
        Its unit as shown.
    scale
        What its value is multiplied by.
    digits
        Digits after the point in tables.
    """

    words: str
    unit: str
    scale: float
    digits: int


METRIC_NAMES = {
    "goal_time_s": MetricName("time to goal", "s", 1.0, 1),
    "capture_time_s": MetricName("time to capture", "s", 1.0, 2),
    "path_m": MetricName("driven length", "m", 1.0, 1),
    "realised_cost_m": MetricName("realised cost", "m", 1.0, 1),
    "clairvoyant_cost_m": MetricName("clairvoyant cost", "m", 1.0, 1),
    "cost_ratio": MetricName("cost ratio to the clairvoyant", "1", 1.0, 3),
    "true_connected_share": MetricName("connected in truth", "%", 100.0, 1),
    "longest_outage_m": MetricName("longest outage", "m", 1.0, 1),
    "longest_outage_s": MetricName("longest outage", "s", 1.0, 1),
    "stated_times_connected": MetricName("stated times connected", "%", 100.0, 1),
    "least_connected_share": MetricName("least connected share", "%", 100.0, 1),
    "data_mbit": MetricName("delivered data", "Mbit", 1.0, 2),
    "predicted_min_connectivity": MetricName("least P(connected) of driven steps", "1", 1.0, 3),
    "time_averaged_trace_p": MetricName("time-averaged tr P", "m2", 1.0, 3),
    "trace_p": MetricName("tr P", "m2", 1.0, 3),
    "target_lost": MetricName("target lost", "%", 100.0, 1),
    "final_trace_p": MetricName("final tr P", "m2", 1.0, 3),
    "time_averaged_det_p": MetricName("time-averaged det P", "m4", 1.0, 4),
    "nees": MetricName("NEES of the station", "1", 1.0, 2),
    "nis": MetricName("NIS of the robots", "1", 1.0, 2),
    "nis_low": MetricName("least NIS of filters that are right", "1", 1.0, 2),
    "nis_high": MetricName("largest NIS of filters that are right", "1", 1.0, 2),
    "delivered": MetricName("delivered", "%", 100.0, 1),
    "rms_db": MetricName("RMS error", "dB", 1.0, 2),
    "rms_without_multipath_db": MetricName("RMS error without multipath", "dB", 1.0, 2),
    "path_loss_variance_db2": MetricName("path loss variance over the workspace", "dB2", 1.0, 3),
    "anmse_db": MetricName("ANMSE", "dB", 1.0, 2),
    "measured_steps": MetricName("steps that measured", "1", 1.0, 1),
    "trace_m_db": MetricName("tr M", "dB", 1.0, 2),
    "log_det_m": MetricName("log det M", "nats", 1.0, 2),
    "min_separation_m": MetricName("least distance of two robots", "m", 1.0, 3),
    "min_moving_clearance_m": MetricName("least distance from moving obstacles", "m", 1.0, 3),
    "polish_gain": MetricName("gain of the polish", "%", 100.0, 2),
}


def metric_name(metric: str) -> MetricName:
    """How `metric` is shown; a metric unknown here is shown by its own name, as it is."""
    return METRIC_NAMES.get(metric, MetricName(spaced(metric), "as is", 1.0, 3))


MISSING = "-"

WIDTH = 100
"""Letters in a line of a comparison's table."""

PAIRED_WIDTH = 30
"""Letters in a cell of the table of paired differences."""

_Column = tuple[str, Callable[[ReliabilityBin], str]]

VERIFIED, POLISH = ("verified [%]", ""), ("polish gain [%]", "polish_gain")
"""Columns of every task; the first is of no metric."""

GOAL_COLUMNS = (
    ("time to goal [s]", "goal_time_s"),
    ("connected [%]", "true_connected_share"),
    ("longest outage [m]", "longest_outage_m"),
    ("realised cost [m]", "realised_cost_m"),
    ("cost ratio", "cost_ratio"),
    ("least P", "predicted_min_connectivity"),
    VERIFIED,
    POLISH,
)
"""Metrics shown where there is a goal, and their headings; the first with its interval."""


def comparison_text(comparison: Comparison) -> str:
    """Table of a comparison, aligned, one line a setting in the order of the rows.

    What does not fit `WIDTH` letters goes below, with the settings before it again.

    Parameters
    ----------
    comparison
        The comparison. A metric that it does not have, or that no run has, is shown as ``-``.
    """
    settings: dict[Hashable, dict[str, Row]] = {}
    for row in comparison.rows:
        settings.setdefault(setting_of(row), {})[row.metric] = row
    problems = (comparison.problem, *comparison.others)
    to_goal = all(problem.task == "reach" for problem in problems)
    shown = GOAL_COLUMNS if to_goal else _columns(comparison.rows)
    swept = list(dict.fromkeys(key for row in comparison.rows for key in row.sweep))
    words = [
        *(["problem"] if comparison.others else []),
        *swept,
        *(["cost to go"] if to_goal else []),
        "planner",
    ]
    headings = [heading for heading, _ in shown]
    header = [*words, "horizon", "runs", "stalled", *headings, "step p50 [ms]", "step p95 [ms]"]
    lines: list[list[str]] = []
    for rows in settings.values():
        one = next(iter(rows.values()))
        lines.append(
            [
                *([one.problem] if comparison.others else []),
                *(str(one.sweep[key]) for key in swept),
                *([str(one.cost_to_go)] if to_goal else []),
                one.planner,
                *_cells(one.horizon, rows, [name for _, name in shown]),
            ]
        )
    title = (
        f"{', '.join(problem.name for problem in problems)}: {len(comparison.runs)} runs in "
        f"{comparison.wall_s:.1f} s; means over runs, {interval_words(comparison)}"
    )
    if comparison.resumed:
        title += f"; {comparison.resumed} runs were finished before"
    if to_goal:
        title += "; time to goal and cost ratio (to the clairvoyant) over the runs that arrived"
    table = [*textwrap.wrap(title, WIDTH), "", *_in_blocks([header, *lines], len(words))]
    table += ["", *paired_lines(list(settings.values()), [name for _, name in shown if name])]
    table += reliability_lines(comparison.reliability, "steps", "seeds")
    return "\n".join(table).rstrip("\n")


def paired_lines(settings: Sequence[dict[str, Row]], metrics: Sequence[str]) -> list[str]:
    """Table of differences from the first setting, seed by seed, one line a setting and metric.

    Only those with an interval that does not hold zero; a word where there is none.

    Parameters
    ----------
    settings
        Rows by metric of each setting.
    metrics
        Those that are shown.
    """
    if len(settings) < 2:
        return []
    rows = [rows[metric] for rows in settings[1:] for metric in metrics if metric in rows]
    apart = [
        (row, row.difference_low, row.difference_high)
        for row in rows
        if row.difference_low is not None
        and row.difference_high is not None
        and not row.difference_low <= 0.0 <= row.difference_high
    ]
    known = sum(row.difference_low is not None for row in rows)
    title = (
        f"paired differences from the first setting, seed by seed: {len(apart)} of {known} "
        "intervals (95 %) leave out zero"
    )
    if not known:
        return []
    several = len({row.problem for each in settings for row in each.values()}) > 1
    lines = [["setting", "metric", "difference", "95 % interval"]]
    for row, low, high in apart:
        name = metric_name(row.metric)
        ends = [f"{name.scale * end:+.{name.digits}f}" for end in (low, high)]
        difference = f"{name.scale * (row.paired_difference or 0.0):+.{name.digits}f}"
        words = ", ".join(
            part
            for part in (
                row.problem if several else "",
                sweep_words(row),
                row.cost_to_go or "",
                row.planner,
                str(row.horizon),
            )
            if part
        )
        cells = [words, f"{name.words} [{name.unit}]", difference, " to ".join(ends)]
        below = [textwrap.wrap(cell, PAIRED_WIDTH) for cell in cells]
        lines += [list(line) for line in zip_longest(*below, fillvalue="")]
    return [title, *(aligned(lines, 2) if apart else []), ""]


def interval_words(comparison: Comparison, where: str = "in brackets") -> str:
    """Return where the 95 % intervals stand, or why there is none."""
    if any(row.ci_low is not None for row in comparison.rows):
        return f"95 % interval {where}"
    return f"no interval from fewer than {FEWEST_GROUPS}"


def reliability_lines(
    bins: Sequence[ReliabilityBin], what: str, groups: str | None = None
) -> list[str]:
    """Table of predicted against true connection, one line a bin; no line without bins.

    Parameters
    ----------
    bins
        As :func:`planopt.channel.validation.calibration.reliability` gives them.
    what, groups
        What was predicted and what it is grouped by, in the plural; None for one group.
    """
    if not bins:
        return []
    title = "predicted against true connection"
    columns: list[_Column] = [("predicted P", _range), (what, lambda one: str(one.count))]
    if groups is not None:
        columns.append((groups, lambda one: str(one.groups)))
    columns.append(("mean predicted", lambda one: f"{one.predicted:.4f}"))
    columns.append(("connected", lambda one: f"{one.realised:.4f}"))
    if any(one.interval for one in bins):
        title += f"; intervals over {groups}"
        columns.append(("95 % interval", _interval))
    elif groups is not None:
        title += f"; no interval from fewer than {FEWEST_GROUPS} {groups}"
    header = [heading for heading, _ in columns]
    return [title, *aligned([header, *([cell(one) for _, cell in columns] for one in bins)], 1)]


def _range(one: ReliabilityBin) -> str:
    return f"{one.low:g} to {one.high:g}"


def _interval(one: ReliabilityBin) -> str:
    """The interval, with a mark where it misses the mean prediction."""
    if one.interval is None:
        return MISSING
    words = f"{one.interval[0]:.4f} to {one.interval[1]:.4f}"
    return words if one.agrees else f"{words} *"


def _columns(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Heading and name of every metric of a sum of terms."""
    metrics = [m for m in dict.fromkeys(row.metric for row in rows) if m != "polish_gain"]
    own = [(f"{metric_name(m).words} [{metric_name(m).unit}]", m) for m in metrics]
    return [*own, VERIFIED, POLISH]


def _cells(horizon: int, rows: dict[str, Row], shown: Sequence[str]) -> list[str]:
    """The numbers of a line; what is not of one metric is the same in every row."""
    one = next(iter(rows.values()))
    return [
        str(horizon),
        str(one.seeds),
        str(one.stalled),
        *(
            _mean(rows, metric, interval=metric == shown[0])
            if metric
            else (MISSING if one.verified_rate is None else f"{100.0 * one.verified_rate:.1f}")
            for metric in shown
        ),
        *(
            MISSING if seconds is None else f"{1e3 * seconds:.1f}"
            for seconds in (one.p50_step_s, one.p95_step_s)
        ),
    ]


def _mean(rows: dict[str, Row], metric: str, *, interval: bool = False) -> str:
    """Mean of a metric in the unit shown, with its interval if asked for and known."""
    row, name = rows.get(metric), metric_name(metric)
    if row is None or row.mean is None:
        return MISSING
    text = f"{name.scale * row.mean:.{name.digits}f}"
    if interval and row.ci_low is not None and row.ci_high is not None:
        low, high = name.scale * row.ci_low, name.scale * row.ci_high
        text += f" ({low:.{name.digits}f} to {high:.{name.digits}f})"
    return text


def _in_blocks(table: Sequence[Sequence[str]], words: int) -> list[str]:
    """Return aligned lines, headings over several where they are wider than what is below them.

    Blocks of columns of at most `WIDTH` letters stand below each other, an empty line between
    them; each begins with the first `words` columns and the one after, which name the line.
    """
    columns = [
        [textwrap.wrap(heading, max(map(len, (*heading.split(), *below)))), below]
        for heading, *below in zip(*table, strict=True)
    ]
    widths = [2 + max(map(len, (*heading, *below))) for heading, below in columns]
    first = words + 1
    blocks, room = [columns[:first]], WIDTH + 2 - sum(widths[:first])
    for column, width in zip(columns[first:], widths[first:], strict=True):
        if width > room and len(blocks[-1]) > first:
            blocks.append(columns[:first])
            room = WIDTH + 2 - sum(widths[:first])
        blocks[-1].append(column)
        room -= width
    lines: list[str] = []
    for block in blocks:
        height = max(len(heading) for heading, _ in block)
        padded = [[*[""] * (height - len(heading)), *heading, *below] for heading, below in block]
        lines += ["", *aligned(list(zip(*padded, strict=True)), words)]
    return lines[1:]


def aligned(table: Sequence[Sequence[str]], words: int) -> list[str]:
    """Return columns two spaces apart, the first `words` to the left, the others to the right."""
    widths = [max(len(line[column]) for line in table) for column in range(len(table[0]))]
    return [
        "  ".join(
            cell.ljust(width) if column < words else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in table
    ]
