"""Table of a comparison: means and paired differences of metrics, with intervals."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.special import stdtrit  # pyright: ignore[reportUnknownVariableType]

from planopt.arrays import Floats
from planopt.channel.calibration import FEWEST_GROUPS, ReliabilityBin, reliability
from planopt.planning.loop.metrics import ANY, POSSIBLE
from planopt.planning.loop.results import NOT_DONE, RunSummary
from planopt.problems.settings import OWN

CONFIDENCE = 0.95

SettingKey = tuple[str, str, str | None, str, int]
"""Key of a setting: problem, sweep as text, cost-to-go, planner and horizon."""


@dataclass(frozen=True)
class Row:
    """Statistics of one metric of one setting over all seeds; None for missing values."""

    horizon: int  # Planning horizon in steps
    planner: str
    cost_to_go: str | None
    seeds: int  # Number of runs
    stalled: int  # Number of runs that did not complete their task
    metric: str  # Such as ``goal_time_s``
    mean: float | None  # Mean over the `count` runs for which the metric exists
    ci_low: float | None
    ci_high: float | None
    count: int
    # Geometric mean over seeds of the ratio to the reference, if both are positive
    paired_ratio: float | None
    verified_rate: float | None  # Share of released steps that were verified, over all runs
    p50_step_s: float | None  # Median and 95 % quantile of the planning time per step
    p95_step_s: float | None
    # Mean over seeds of the difference from the reference, if both exist
    paired_difference: float | None = None
    difference_low: float | None = None
    difference_high: float | None = None
    ratio_low: float | None = None  # Interval of the paired ratio, computed on logarithms
    ratio_high: float | None = None
    problem: str = ""
    sweep: Mapping[str, Any] = field(default_factory=dict[str, Any])  # Values of changed keys


@dataclass(frozen=True)
class Setting:
    """Setting of a comparison, with its runs and rows."""

    runs: Sequence[RunSummary]  # Ordered by seed
    rows: Mapping[str, Row]  # By metric

    @property
    def one(self) -> RunSummary:
        """Return the first run of the setting, which describes the setting."""
        return self.runs[0]

    @property
    def stalled(self) -> int:
        """Return the number of runs that did not complete their task."""
        return sum(run.exit_code == NOT_DONE for run in self.runs)


def comparison_rows(runs: Sequence[RunSummary]) -> list[Row]:
    """Return the rows of all settings, whose runs have the same seeds in the same order."""
    # If every problem has one setting, the first of all is the reference.
    settings = runs_by_setting(runs)
    first = {each[0].problem: each for each in reversed(settings)}
    if len(first) == len(settings):
        first = dict.fromkeys(first, settings[0])
    return [row for each in settings for row in tabulate(each, first[each[0].problem])]


def tabulate(runs: Sequence[RunSummary], reference: Sequence[RunSummary]) -> list[Row]:
    """Return one row per metric of runs, paired with reference runs of the same seeds in order."""
    one = runs[0]
    steps = np.concatenate([run.step_s for run in runs])
    rates = np.array([run.verified_rate for run in runs])
    released = np.array([sum(run.rungs.values()) for run in runs], dtype=float)
    known = np.isfinite(rates)
    count = released[known].sum()
    rate = float(rates[known] @ released[known] / count) if count else 1.0
    rows: list[Row] = []
    for metric in dict.fromkeys(name for run in runs for name in run.metrics):
        values, others = (
            np.array([run.metrics.get(metric, np.nan) for run in each], dtype=float)
            for each in (runs, reference)
        )
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
                horizon=one.horizon,
                planner=one.planner,
                cost_to_go=one.cost_to_go,
                seeds=len(runs),
                stalled=sum(run.exit_code == NOT_DONE for run in runs),
                metric=metric,
                mean=float(there.mean()) if there.size else None,
                ci_low=low,
                ci_high=high,
                count=int(there.size),
                paired_ratio=float(np.exp(ratios.mean())) if ratios.size else None,
                verified_rate=rate if known.any() else None,
                p50_step_s=float(np.median(steps)) if steps.size else None,
                p95_step_s=float(np.quantile(steps, 0.95)) if steps.size else None,
                paired_difference=float(differences.mean()) if differences.size else None,
                difference_low=difference_low,
                difference_high=difference_high,
                ratio_low=ratio_low,
                ratio_high=ratio_high,
                problem=one.problem,
                sweep=one.sweep,
            )
        )
    return rows


def mean_interval(
    values: Floats, possible: tuple[float, float] = ANY
) -> tuple[float | None, float | None]:
    """Return the clipped Student interval of the mean; None for too few values."""
    if values.size < FEWEST_GROUPS:
        return None, None
    quantile = np.asarray(stdtrit(values.size - 1, 0.5 + CONFIDENCE / 2))
    half = float(quantile) * float(values.std(ddof=1)) / float(np.sqrt(values.size))
    mean = float(values.mean())
    least, largest = possible
    return max(mean - half, least), min(mean + half, largest)


def log_ratios(values: Floats, others: Floats) -> Floats:
    """Return the logarithms of paired ratios, restricted to positive finite pairs."""
    both = np.isfinite(values) & np.isfinite(others) & (values > 0.0) & (others > 0.0)
    return np.log(values[both] / others[both])


def runs_reliability(runs: Sequence[RunSummary]) -> tuple[ReliabilityBin, ...]:
    """Return bins of predicted against true connection over all steps of runs, grouped by seed."""
    seeds = [np.full(len(run.connectivity), run.seed, dtype=np.intp) for run in runs]
    return reliability(
        np.concatenate([run.connectivity for run in runs]),
        np.concatenate([run.connected for run in runs]),
        np.concatenate(seeds),
    )


def runs_by_setting(runs: Sequence[RunSummary]) -> list[list[RunSummary]]:
    """Return the runs grouped by setting, in order of first occurrence."""
    found: dict[SettingKey, list[RunSummary]] = {}
    for run in runs:
        found.setdefault(setting_of(run), []).append(run)
    return list(found.values())


def setting_of(one: RunSummary | Row) -> SettingKey:
    """Return the key of a run's setting."""
    return one.problem, sweep_words(one), one.cost_to_go, one.planner, one.horizon


def has_horizon(one: RunSummary | Row) -> bool:
    """Return whether the planner has a horizon; False if it optimises the whole run."""
    kind = OWN.get(one.planner)
    return kind is None or not kind.foresees


def sweep_words(
    one: RunSummary | Row, left_out: str | None = None, names: Mapping[str, str] | None = None
) -> str:
    """Return the changed keys of a run's setting and their values as text."""
    called = names or {}
    return ", ".join(
        f"{called.get(key, key)} = {value}" for key, value in one.sweep.items() if key != left_out
    )


def setting_words(
    one: RunSummary | Row, names: Mapping[str, str], *, several_problems: bool
) -> str:
    """Return text that identifies a run's setting; arguments as for :func:`sweep_words`."""
    own = {
        "objective.cost_to_go": one.cost_to_go and f"{one.cost_to_go} cost-to-go",
        "planner.name": f"planner {one.planner}",
        "planner.horizon": f"horizon {one.horizon}" if has_horizon(one) else None,
    }
    parts = (
        one.problem if several_problems else None,
        sweep_words(one, names=names),
        *(words for key, words in own.items() if key not in one.sweep),
    )
    return ", ".join(part for part in parts if part)


def short_keys(settings: Iterable[RunSummary | Row]) -> dict[str, str]:
    """Return short names of the swept keys: their shortest unambiguous suffixes."""
    keys = list(dict.fromkeys(key for one in settings for key in one.sweep))
    found = {key: key for key in keys}
    if len(keys) > 1:
        for key in keys:
            for count in range(key.count(".") + 1, 0, -1):
                end = ".".join(key.split(".")[-count:])
                if sum(f".{other}".endswith(f".{end}") for other in keys) == 1:
                    found[key] = end
    return found
