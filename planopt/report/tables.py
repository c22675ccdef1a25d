"""Results as plain text: names of metrics, aligned columns, comparisons, reliability."""

import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from planopt.channel.calibration import FEWEST_GROUPS, ReliabilityBin
from planopt.report.panel import spaced
from planopt.studies.comparison import (
    Comparison,
    Row,
    Setting,
    has_horizon,
    setting_words,
    short_keys,
)


@dataclass(frozen=True)
class MetricName:
    """Name, unit and number format of a metric."""

    words: str
    unit: str  # "1" for numbers without unit
    scale: float = 1.0  # Factor from the value to the unit
    digits: int | None = 1  # Decimal places in tables; None for four significant digits
    most: float = math.inf  # Largest possible value, in the unit

    def shown(self, value: float, sign: str = "") -> str:
        """Return a value in the unit as text."""
        return f"{self.scale * value:{sign}{'.4g' if self.digits is None else f'.{self.digits}f'}}"


METRIC_NAMES = {
    "verified_rate": MetricName("plans verified", "%", 100.0, most=100.0),
    "connected_share": MetricName("cells with P(connected) of 0.5 or more", "%", 100.0, most=100.0),
    "cell_m": MetricName("length of a cell", "m"),
    "threshold_dbm": MetricName("minimum power of a connection", "dBm"),
    "objective": MetricName("objective value", "1"),
    "bound": MetricName("proven bound of the objective", "1"),
    "min_clearance_m": MetricName("clearance from obstacles", "m"),
    "iterations": MetricName("iterations of the solver", "1"),
    "wall_s": MetricName("computing time", "s"),
    "goal_time_s": MetricName("time to goal", "s"),
    "capture_time_s": MetricName("time to capture", "s", digits=2),
    "cost_w": MetricName("power", "W", digits=3),
    "energy_per_capture_j": MetricName("energy per capture", "J"),
    "slot_width_s": MetricName("slot width", "ms", 1e3, 3),
    "frame_s": MetricName("frame duration", "s", digits=4),
    "bits_per_axis": MetricName("bits per axis", "1"),
    "rate_divisor": MetricName("rate divisor", "1"),
    "path_m": MetricName("driven length", "m"),
    "realised_cost_m": MetricName("realised cost", "m"),
    "clairvoyant_cost_m": MetricName("clairvoyant cost", "m"),
    "cost_ratio": MetricName("cost / clairvoyant cost", "1", digits=3),
    "true_connected_share": MetricName("steps connected", "%", 100.0, most=100.0),
    "reading_share": MetricName("steps with a reading", "%", 100.0, most=100.0),
    "longest_outage_m": MetricName("longest outage", "m"),
    "longest_outage_s": MetricName("longest outage", "s"),
    "stated_times_connected": MetricName("connected at the stated times", "%", 100.0, most=100.0),
    "least_connected_share": MetricName("connected, least of all robots", "%", 100.0, most=100.0),
    "data_mbit": MetricName("delivered data", "Mbit", digits=2),
    "predicted_min_connectivity": MetricName(
        "lowest predicted P(connected)", "1", digits=3, most=1.0
    ),
    "time_averaged_trace_p": MetricName("tr P, mean over time", "m²", digits=3),
    "trace_p": MetricName("tr P", "m²", digits=3),
    "target_lost": MetricName("target lost", "%", 100.0, most=100.0),
    "final_trace_p": MetricName("final tr P", "m²", digits=3),
    "time_averaged_normalised_trace_p": MetricName(
        "tr P / initial tr P, mean over time", "1", digits=4
    ),
    "final_normalised_trace_p": MetricName("final tr P / initial tr P", "1", digits=4),
    "normalised_trace_p": MetricName("tr P / initial tr P", "1", digits=4),
    "time_averaged_det_p": MetricName("det P, mean over time", "m⁴", digits=4),
    "nees": MetricName("NEES of the station", "1", digits=2),
    "nis": MetricName("NIS of the robots", "1", digits=2),
    "delivered": MetricName("packets delivered", "%", 100.0, most=100.0),
    "mean_squared_error_db2": MetricName("mean squared map error", "dB²", digits=2),
    "rms_db": MetricName("RMS map error", "dB", digits=2),
    "rms_without_multipath_db": MetricName("RMS map error without multipath", "dB", digits=2),
    "path_loss_variance_db2": MetricName("mean variance of the path loss", "dB²", digits=3),
    "anmse_db": MetricName("normalised squared map error (ANMSE)", "dB", digits=2),
    "measured_steps": MetricName("number of steps with a measurement", "1"),
    "trace_m_db": MetricName("tr M / |θ|²", "dB", digits=2),
    "log_det_m": MetricName("log det M", "nats", digits=2),
    "min_separation_m": MetricName("minimum distance between robots", "m", digits=3),
    "min_moving_clearance_m": MetricName("minimum distance to moving obstacles", "m", digits=3),
    "polish_gain": MetricName("objective gain by refinement", "%", 100.0, 2),
    "cost_first": MetricName("initial coverage cost", "m²", digits=None),
    "cost_last": MetricName("final coverage cost", "m²", digits=None),
    "cost_mean": MetricName("mean coverage cost", "m²", digits=None),
    "residual_m": MetricName("final distance to the targets, largest", "m", digits=2),
    "settled_s": MetricName("time to settle", "s"),
    "energy_m2_s": MetricName("control energy (integral of squared speed)", "m²/s"),
    "count_error_most": MetricName("largest error of the agent count", "1", digits=2),
    "pursuer_path_m": MetricName("driven length of the pursuers", "m"),
    "evader_path_m": MetricName("driven length of the evaders", "m"),
    "records": MetricName("reports used", "1"),
    "mean_age_s": MetricName("mean age of reports", "s", digits=2),
    "mean_error_m": MetricName("mean error of reports", "m", digits=2),
}

UNITS = {
    ending: ending.replace("_", "/")
    for ending in ("m_s", "m2_s", "m²", "m4", "db2", "m", "s", "w", "j", "db", "dbm")
} | {"w": "W", "j": "J", "db": "dB", "dbm": "dBm", "db2": "dB²"}
"""Units by the ending of a key, for metrics that are not listed; longer endings first."""


BANDS = {"nis": ("nis_low", "nis_high", "range of 95 % of consistent filters")}
"""Metrics with an expected range: names of the metrics of both bounds, and a description."""
SYMBOLS = {
    "trace_p": "P: covariance of the target position that the station estimates",
    "log_det_m": "M: covariance of the estimated path loss parameters θ",
}
"""Explanations of symbols, by a metric whose name contains the symbol."""
BAND_ENDS = {end: metric for metric, (*ends, _) in BANDS.items() for end in ends}
"""Metrics that are bounds of another metric's range, and so have no column of their own."""


def metric_name(metric: str) -> MetricName:
    """Return the name of a metric; for an unlisted metric, derive it from the key."""
    if metric in METRIC_NAMES:
        return METRIC_NAMES[metric]
    for ending, unit in UNITS.items():
        if metric.endswith(f"_{ending}"):
            return MetricName(spaced(metric.removesuffix(f"_{ending}")), unit, digits=None)
    return MetricName(spaced(metric), "1", digits=None)


def metric_label(metric: str) -> str:
    """Return the name of a metric with its unit, if it has one."""
    name = metric_name(metric)
    return name.words if name.unit == "1" else f"{name.words} [{name.unit}]"


def figures_in_words(figures: Iterable[tuple[str, object]]) -> Iterator[tuple[str, object]]:
    """Yield names with units and values of key figures; missing values are left out."""
    for key, value in figures:
        if isinstance(value, float):
            if math.isfinite(value):
                yield metric_label(key), metric_name(key).scale * value
        elif value is not None:
            yield metric_label(key), value


def symbols_in_words(metrics: Iterable[str]) -> list[str]:
    """Return a line that explains symbols in the names of metrics; empty if there are none."""
    listed = " ".join(metrics)
    words = [words for metric, words in SYMBOLS.items() if metric in listed]
    return ["; ".join(words)] if words else []


MISSING = "-"

WIDTH = 100  # Maximum line length of a comparison table in characters
OWN = "own"  # Text for a swept key that a setting leaves unchanged
SETTING_WIDTH = 80  # Maximum length in characters of a description, if settings are numbered
VERIFIED, POLISH = ("plans verified [%]", ""), ("objective gain by refinement [%]", "polish_gain")
"""Columns of every task, as heading and metric; the share of verified plans has no metric."""

GOAL_COLUMNS = (
    ("time to goal [s]", "goal_time_s"),
    ("steps connected [%]", "true_connected_share"),
    ("longest outage [m]", "longest_outage_m"),
    ("realised cost [m]", "realised_cost_m"),
    ("cost ratio", "cost_ratio"),
    ("lowest predicted P(connected)", "predicted_min_connectivity"),
    VERIFIED,
    POLISH,
)
"""Metrics shown for tasks with a goal, and their headings; the first has an interval."""


def comparison_text(comparison: Comparison) -> str:
    """Return a comparison as an aligned text table, one line per setting in the order of the rows.

    Columns beyond `WIDTH` characters follow in further blocks that repeat the names of the
    settings. With several swept keys, settings are numbered and described once.

    Parameters
    ----------
    comparison
        Comparison to print. Missing metrics are shown as ``-``; without a goal, metrics that no
        setting has, and those that are zero in all of them, are omitted.
    """
    settings = comparison.settings
    problems = (comparison.problem, *comparison.others)
    to_goal = all(problem.has_goal for problem in problems)
    shown = GOAL_COLUMNS if to_goal else _columns(comparison.rows)
    title = (
        f"{', '.join(problem.name for problem in problems)}: {len(comparison.runs)} runs in "
        f"{comparison.wall_s:.1f} s; means over runs, {interval_words(comparison)}"
    )
    if comparison.resumed:
        title += f"; {comparison.resumed} runs were reused from an earlier call"
    if to_goal:
        title += (
            ". Time to goal and cost ratio are means over runs that arrived. Cost ratio: realised "
            "cost / cost of a lattice path planned with the known channel"
        )
    header, *lines = _names(comparison, to_goal=to_goal)
    metrics = [name for _, name in shown]
    headings = ["runs", "stalled runs", *(heading for heading, _ in shown)]
    table = [
        [
            *header,
            *headings,
            "planning time per step, median [ms]",
            "planning time per step, 95th percentile [ms]",
        ]
    ]
    for names, setting in zip(lines, settings, strict=True):
        table.append([*names, *_cells(setting, metrics)])
    if not to_goal:
        columns = zip(*table, strict=True)
        known = [c for n, c in enumerate(columns) if n < len(header) or set(c[1:]) != {MISSING}]
        table = [list(line) for line in zip(*known, strict=True)]
    text = [*textwrap.wrap(title, WIDTH), "", *_listed(comparison), *_in_blocks(table, len(header))]
    text += symbols_in_words(metrics)
    text += ["", *_paired(settings, [header, *lines], [name for name in metrics if name])]
    text += reliability_lines(comparison.reliability, "steps", "seeds")
    return "\n".join(text).rstrip("\n")


def _names(comparison: Comparison, *, to_goal: bool) -> list[list[str]]:
    """Return headings and cells of the columns that identify the settings."""
    settings, swept = comparison.settings, list(short_keys(comparison.runs))
    if len(swept) > 1:
        return [["setting"], *([str(number + 1)] for number in range(len(settings)))]
    ones = [setting.one for setting in settings]
    columns = [["problem", *(one.problem for one in ones)]] if comparison.others else []
    columns += [[key, *(str(one.sweep.get(key, OWN)) for one in ones)] for key in swept]
    columns += [["cost-to-go", *(str(one.cost_to_go) for one in ones)]] if to_goal else []
    horizons = [str(one.horizon) if has_horizon(one) else MISSING for one in ones]
    columns += [["planner", *(one.planner for one in ones)], ["horizon", *horizons]]
    return [list(line) for line in zip(*columns, strict=True)]


def _listed(comparison: Comparison) -> list[str]:
    """Return a line for each numbered setting; empty if at most one key is swept."""
    names = short_keys(comparison.runs)
    if len(names) < 2:
        return []
    lines = ["settings"]
    for number, words in enumerate(setting_words(comparison), start=1):
        first, *more = textwrap.wrap(words, SETTING_WIDTH) or [""]
        lines += [f"{number:>7}  {first}", *(f"{'':9}{part}" for part in more)]
    long = [f"{short} is {key}" for key, short in names.items() if short != key]
    return [*lines, *textwrap.wrap(", ".join(long), WIDTH), ""]


def _paired(
    settings: Sequence[Setting], names: Sequence[Sequence[str]], metrics: Sequence[str]
) -> list[str]:
    """Return the table of paired differences; intervals that exclude zero have a star."""
    cells = {m: [_difference(each.rows.get(m)) for each in settings] for m in metrics}
    known = [m for m in metrics if any(cell != MISSING for cell in cells[m])]
    if not known:
        return []
    rows = {m: [each.rows[m] for each in settings[1:] if m in each.rows] for m in known}
    ends = "paired_difference", "difference_low", "difference_high"
    shown = [m for m in known if any(getattr(row, end) for row in rows[m] for end in ends)]
    same = [metric_name(metric).words for metric in known if metric not in shown]
    intervals = [cell for m in shown for cell in cells[m][1:] if cell != MISSING]
    apart = sum(cell.endswith("*") for cell in intervals)
    title = (
        "mean differences from the first setting on the same seeds, with 95 % intervals; "
        f"{apart} of {len(intervals)} intervals exclude zero (*)"
    )
    table = [[*names[0], *map(metric_label, shown)]]
    for number, name in enumerate(names[2:], start=1):
        table.append([*name, *(cells[metric][number] for metric in shown)])
    alike = textwrap.wrap(f"equal in all settings: {', '.join(same)}", WIDTH) if same else []
    return [*textwrap.wrap(title, WIDTH), *_in_blocks(table, len(names[0])), *alike, ""]


def _difference(row: Row | None) -> str:
    """Return text: the paired difference, its interval, and a star if this excludes zero."""
    if row is None or row.paired_difference is None:
        return MISSING
    low, high, name = row.difference_low, row.difference_high, metric_name(row.metric)
    if low is None or high is None:
        return MISSING
    mean, begin, end = (name.shown(value, "+") for value in (row.paired_difference, low, high))
    return f"{mean} ({begin} to {end})" + ("" if low <= 0.0 <= high else " *")


def _columns(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Return heading and name of every available metric, for problems without a goal."""
    there = dict.fromkeys(row.metric for row in rows if row.mean)
    bands = {metric: f", and {words}" for metric, (*_, words) in BANDS.items()}
    metrics = [m for m in there if m != "polish_gain" and m not in BAND_ENDS]
    return [*((metric_label(m) + bands.get(m, ""), m) for m in metrics), VERIFIED, POLISH]


def _cells(setting: Setting, shown: Sequence[str]) -> list[str]:
    """Return the cells of a setting: runs, stalled runs, metrics and step times."""
    one = next(iter(setting.rows.values()), None)
    rate = None if one is None else one.verified_rate
    verified = MISSING if rate is None else f"{100.0 * rate:.1f}"
    cells = [str(len(setting.runs)), str(setting.stalled)]
    for metric in shown:
        text = _mean(setting.rows, metric, interval=metric == shown[0]) if metric else verified
        cells.append(text)
    times_s = (None, None) if one is None else (one.p50_step_s, one.p95_step_s)
    return [*cells, *(MISSING if s is None else f"{1e3 * s:.1f}" for s in times_s)]


def _mean(rows: Mapping[str, Row], metric: str, *, interval: bool) -> str:
    """Return the mean of a metric in its unit, with interval (if `interval`) and expected range."""
    row, name = rows.get(metric), metric_name(metric)
    if row is None or row.mean is None:
        return MISSING
    text = name.shown(row.mean)
    if interval and row.ci_low is not None and row.ci_high is not None:
        text += f" ({name.shown(row.ci_low)} to {name.shown(row.ci_high)})"
    ends = [rows[end].mean for end in BANDS.get(metric, ())[:2] if end in rows]
    return f"{text}, {' to '.join(name.shown(end or 0.0) for end in ends)}" if ends else text


def _in_blocks(table: Sequence[Sequence[str]], first: int) -> list[str]:
    """Return lines at most `WIDTH` long, in blocks that each repeat the `first` columns."""
    columns = [
        [textwrap.wrap(heading, width, break_on_hyphens=False), below]
        for heading, *below in zip(*table, strict=True)
        for width in [max(len(heading) // 4 + 2, *map(len, (*heading.split(), *below)))]
    ]
    widths = [2 + max(map(len, (*heading, *below))) for heading, below in columns]
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
        lines += ["", *aligned(list(zip(*padded, strict=True)), first - 1)]
    return lines[1:]


def interval_words(comparison: Comparison, where: str = "in brackets") -> str:
    """Return a note on where the 95 % intervals are shown, or why there is none."""
    if any(row.ci_low is not None for row in comparison.rows):
        return f"95 % interval {where}"
    return f"no intervals for fewer than {FEWEST_GROUPS} seeds"


def reliability_lines(
    bins: Sequence[ReliabilityBin], what: str, groups: str | None = None
) -> list[str]:
    """Return the table of predicted and observed connection, one line per bin."""
    if not bins:
        return []
    title = f"calibration of P(connected): mean prediction and observed share of connected {what}"
    with_intervals = any(one.interval for one in bins)
    columns = [
        ["predicted P", *(f"{one.low:g} to {one.high:g}" for one in bins)],
        [what, *(str(one.count) for one in bins)],
        ["mean predicted", *(f"{one.predicted:.4f}" for one in bins)],
        ["observed", *(f"{one.realised:.4f}" for one in bins)],
    ]
    if groups is not None:
        columns.insert(2, [groups, *(str(one.groups) for one in bins)])
    if with_intervals:
        title += f"; intervals over {groups} (* if they exclude the mean prediction)"
        columns.append(["95 % interval", *map(_interval, bins)])
    elif groups is not None:
        title += f"; no intervals for fewer than {FEWEST_GROUPS} {groups}"
    return [*textwrap.wrap(title, WIDTH), *aligned(list(zip(*columns, strict=True)), 1)]


def _interval(one: ReliabilityBin) -> str:
    """Return an interval as text, with a star if it excludes the mean prediction."""
    if one.interval is None:
        return MISSING
    words = f"{one.interval[0]:.4f} to {one.interval[1]:.4f}"
    return words if one.agrees else f"{words} *"


def aligned(table: Sequence[Sequence[str]], words: int) -> list[str]:
    """Return aligned columns: the first `words` are left-aligned, the others right-aligned."""
    widths = [max(len(line[column]) for line in table) for column in range(len(table[0]))]
    return [
        "  ".join(
            cell.ljust(width) if column < words else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in table
    ]
