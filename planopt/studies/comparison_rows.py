"""The table of a comparison: means and paired differences with their intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.validation.calibration import FEWEST_GROUPS
from planopt.planning.loop.metrics import ANY, POSSIBLE
from planopt.planning.run import RunSummary
from planopt.studies.comparison import Row, runs_by_setting

CONFIDENCE = 0.95

NOT_DONE = 4
"""Exit code of runs that did not do what was asked."""


def comparison_rows(runs: Sequence[RunSummary]) -> list[Row]:
    """Tabulate runs, which stand setting by setting with the same seeds in the same order.

    Each setting is paired with the first of its problem; where every problem has only one, with
    that of the first problem.
    """
    settings = runs_by_setting(runs)
    first = {each[0].problem: each for each in reversed(settings)}
    if len(first) == len(settings):
        first = dict.fromkeys(first, settings[0])
    return [row for each in settings for row in tabulate(each, first[each[0].problem])]


def tabulate(runs: Sequence[RunSummary], reference: Sequence[RunSummary]) -> list[Row]:
    """Rows of one setting, one a metric; `reference` holds the same seeds in the same order."""
    each = [run.step_s for run in runs]
    steps = np.concatenate(each)
    rates = np.array([run.verified_rate for run in runs])
    judged = np.isfinite(rates)
    counts = np.array([sum(run.rungs.values()) for run in runs], dtype=float)
    released = float(counts[judged].sum())
    verified = float((rates[judged] * counts[judged]).sum())
    rate = verified / released if released else 1.0
    rows: list[Row] = []
    for metric in dict.fromkeys(name for run in runs for name in run.metrics):
        values, others = _values(runs, metric), _values(reference, metric)
        there = values[np.isfinite(values)]
        low, high = mean_interval(there, POSSIBLE.get(metric, ANY))
        differences = (values - others)[np.isfinite(values) & np.isfinite(others)]
        difference_low, difference_high = mean_interval(differences)
        ratios = log_ratios(values, others)
        ratio_low, ratio_high = (
            None if end is None else float(np.exp(end)) for end in mean_interval(ratios)
        )
        rows.append(
            Row(
                horizon=runs[0].horizon,
                planner=runs[0].planner,
                cost_to_go=runs[0].cost_to_go,
                seeds=len(runs),
                stalled=sum(run.exit_code == NOT_DONE for run in runs),
                metric=metric,
                mean=float(there.mean()) if there.size else None,
                ci_low=low,
                ci_high=high,
                count=int(there.size),
                paired_ratio=float(np.exp(ratios.mean())) if ratios.size else None,
                verified_rate=rate if judged.any() else None,
                p50_step_s=float(np.median(steps)) if steps.size else None,
                p95_step_s=float(np.quantile(steps, 0.95)) if steps.size else None,
                paired_difference=float(differences.mean()) if differences.size else None,
                difference_low=difference_low,
                difference_high=difference_high,
                ratio_low=ratio_low,
                ratio_high=ratio_high,
                problem=runs[0].problem,
                sweep=runs[0].sweep,
            )
        )
    return rows


def mean_interval(
    values: NDArray[np.float64], possible: tuple[float, float] = ANY
) -> tuple[float | None, float | None]:
    """Student interval of the mean at `CONFIDENCE`, cut to the values that are possible.

    The mean is one of these, so that cutting takes nothing from the confidence. None for fewer
    than `FEWEST_GROUPS` values, whose interval tells of their number rather than of them.
    """
    if values.size < FEWEST_GROUPS:
        return None, None
    quantile = np.asarray(stdtrit(values.size - 1, 0.5 + CONFIDENCE / 2))
    half = float(quantile) * float(values.std(ddof=1)) / float(np.sqrt(values.size))
    mean = float(values.mean())
    least, largest = possible
    return max(mean - half, least), min(mean + half, largest)


def log_ratios(values: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Logarithms of the ratios where both are positive and finite; their mean is paired."""
    both = np.isfinite(values) & np.isfinite(others) & (values > 0.0) & (others > 0.0)
    return np.log(values[both] / others[both])


def _values(runs: Sequence[RunSummary], metric: str) -> NDArray[np.float64]:
    return np.array([run.metrics.get(metric, np.nan) for run in runs], dtype=float)
