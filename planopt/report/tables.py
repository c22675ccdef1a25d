"""Names of metrics, and predicted against true connection as a plain-text table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from planopt.channel.calibration import FEWEST_GROUPS, ReliabilityBin
from planopt.report.style import spaced
from planopt.studies.comparison import Comparison


@dataclass(frozen=True)
class MetricName:
    """The name, unit and form of a metric."""

    words: str  # Its name for people
    unit: str  # Its unit as shown
    scale: float  # What its value is multiplied by
    digits: int  # Digits after the point in tables


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
    "time_averaged_normalised_trace_p": MetricName("time-averaged tr P over first", "1", 1.0, 4),
    "final_normalised_trace_p": MetricName("final tr P over first", "1", 1.0, 4),
    "normalised_trace_p": MetricName("over the first", "1", 1.0, 4),
    "time_averaged_det_p": MetricName("time-averaged det P", "m4", 1.0, 4),
    "nees": MetricName("NEES of the station", "1", 1.0, 2),
    "nis": MetricName("NIS of the robots", "1", 1.0, 2),
    "delivered": MetricName("delivered", "%", 100.0, 1),
    "mean_squared_error_db2": MetricName("mean squared error", "dB2", 1.0, 2),
    "rms_db": MetricName("RMS error", "dB", 1.0, 2),
    "rms_without_multipath_db": MetricName("RMS error without multipath", "dB", 1.0, 2),
    "path_loss_variance_db2": MetricName("path loss variance over the workspace", "dB2", 1.0, 3),
    "anmse_db": MetricName("ANMSE", "dB", 1.0, 2),
    "measured_steps": MetricName("steps that measured", "1", 1.0, 1),
    "trace_m_db": MetricName("tr M over |θ|²", "dB", 1.0, 2),
    "log_det_m": MetricName("log det M", "nats", 1.0, 2),
    "min_separation_m": MetricName("least distance of two robots", "m", 1.0, 3),
    "min_moving_clearance_m": MetricName("least distance from moving obstacles", "m", 1.0, 3),
    "polish_gain": MetricName("gain of the polish", "%", 100.0, 2),
}


BANDS = {"nis": ("nis_low", "nis_high", "95 % of filters that are right")}
"""Metrics that come with a band to be in: the metrics of its ends, and what it is in words."""

BAND_ENDS = {end: metric for metric, (*ends, _) in BANDS.items() for end in ends}
"""Metrics that are ends of a band, with the metric that it is for; no columns of their own."""


def metric_name(metric: str) -> MetricName:
    """Return how `metric` is shown; a metric unknown here is shown by its own name, as it is."""
    return METRIC_NAMES.get(metric, MetricName(spaced(metric), "as is", 1.0, 3))


MISSING = "-"

WIDTH = 100
"""Letters in a line of a comparison's table."""

_Column = tuple[str, Callable[[ReliabilityBin], str]]


def interval_words(comparison: Comparison, where: str = "in brackets") -> str:
    """Return where the 95 % intervals stand, or why there is none."""
    if any(row.ci_low is not None for row in comparison.rows):
        return f"95 % interval {where}"
    return f"no interval from fewer than {FEWEST_GROUPS}"


def reliability_lines(
    bins: Sequence[ReliabilityBin], what: str, groups: str | None = None
) -> list[str]:
    """Table of predicted against true connection, one line a bin; no line without bins."""
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
