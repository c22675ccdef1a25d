"""A comparison as a plain-text table."""

from __future__ import annotations

from collections.abc import Sequence

from planopt.report.metric_names import metric_name
from planopt.studies.comparison import Comparison, Row

MISSING = "-"


def comparison_text(comparison: Comparison) -> str:
    """Table of a comparison, aligned, one line a setting in the order of the rows.

    Parameters
    ----------
    comparison
        The comparison. A metric that it does not have, or that no run has, is shown as ``-``.
    """
    settings: dict[tuple[str | None, str, int], dict[str, Row]] = {}
    for row in comparison.rows:
        setting = (row.cost_to_go, row.planner, row.horizon)
        settings.setdefault(setting, {})[row.metric] = row
    header = [
        "cost to go",
        "planner",
        "horizon",
        "runs",
        "stalled",
        "time to goal [s]",
        "connected [%]",
        "longest outage [m]",
        "least P",
        "verified [%]",
        "polish gain [%]",
        "step p50 [ms]",
        "step p95 [ms]",
    ]
    lines = [_cells(*setting, rows) for setting, rows in settings.items()]
    title = (
        f"{comparison.problem.name}: {len(comparison.runs)} runs in {comparison.wall_s:.1f} s; "
        "means over runs, 95 % interval in brackets; time to goal over the runs that arrived"
    )
    return "\n".join([title, "", *_aligned([header, *lines])])


def _cells(cost_to_go: str | None, planner: str, horizon: int, rows: dict[str, Row]) -> list[str]:
    """One line of the table; what is not of one metric is the same in every row."""
    one = next(iter(rows.values()))
    return [
        cost_to_go or "-",
        planner,
        str(horizon),
        str(one.seeds),
        str(one.stalled),
        _mean(rows, "goal_time_s", interval=True),
        _mean(rows, "true_connected_share"),
        _mean(rows, "longest_outage_m"),
        _mean(rows, "predicted_min_connectivity"),
        f"{100.0 * one.verified_rate:.1f}",
        _mean(rows, "polish_gain"),
        f"{1e3 * one.p50_step_s:.1f}",
        f"{1e3 * one.p95_step_s:.1f}",
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


def _aligned(table: Sequence[Sequence[str]]) -> list[str]:
    """Lines of columns two spaces apart, the first two (words) to the left, the others right."""
    widths = [max(len(line[column]) for line in table) for column in range(len(table[0]))]
    return [
        "  ".join(
            cell.ljust(width) if column < 2 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in table
    ]
