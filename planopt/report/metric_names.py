"""What the metrics of a comparison are called, in which unit they are shown, and how precisely."""

from __future__ import annotations

from dataclasses import dataclass

from planopt.report.style import spaced


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
