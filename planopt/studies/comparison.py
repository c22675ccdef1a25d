"""A paired comparison of horizons, planners and costs to go over the same seeds: its data."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from planopt.channel.validation.calibration import ReliabilityBin, reliability
from planopt.errors import A_FOLDER, path_of
from planopt.planning.run import RunSummary
from planopt.problems.planner_kinds import OWN
from planopt.problems.problem import Problem
from planopt.problems.systems import SystemProblem
from planopt.short_repr import short_repr


@dataclass(frozen=True)
class Row:
    """One metric of one setting over all seeds.

    Attributes
    ----------
    horizon, planner, cost_to_go
        The setting.
    seeds
        How many runs.
    stalled
        How many of them did not do what the problem asks: reach the goal, connect, go on.
    metric
        Its name (`goal_time_s`, `true_connected_share`, ...).
    mean, ci_low, ci_high
        Mean over the runs for which the metric exists and its 95 % Student interval, cut to the
        values that the metric can have; None if there is none. With fewer than five runs the
        interval is None.
    count
        How many runs the mean is over: `goal_time_s` exists only where the goal was reached.
    paired_ratio
        Geometric mean over seeds of this metric divided by that of the reference setting (the
        first), where both exist and are positive; None otherwise.
    verified_rate
        Share of released steps that were verified, over all runs; None where nothing is verified.
    p50_step_s, p95_step_s
        Median and 95 % quantile of the planning time of a step, over all runs; None without steps.
    paired_difference, difference_low, difference_high
        Mean over seeds of this metric less that of the reference setting, where both exist, and
        its 95 % Student interval; None if there is none. Metrics in dB have no ratios.
    ratio_low, ratio_high
        95 % Student interval of the paired ratio, over logarithms; None if there is none.
    problem, sweep
        Name of the problem, and what was changed of it.
    """

    horizon: int
    planner: str
    cost_to_go: str | None
    seeds: int
    stalled: int
    metric: str
    mean: float | None
    ci_low: float | None
    ci_high: float | None
    count: int
    paired_ratio: float | None
    verified_rate: float | None
    p50_step_s: float | None
    p95_step_s: float | None
    paired_difference: float | None = None
    difference_low: float | None = None
    difference_high: float | None = None
    ratio_low: float | None = None
    ratio_high: float | None = None
    problem: str = ""
    sweep: Mapping[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class Comparison:
    """The runs of a comparison, and the table made of them.

    Attributes
    ----------
    problem
        The (first) problem as given; what was changed is with each run.
    runs
        In the order setting by setting, seed by seed; of a sum of terms, all robots together.
    rows
        The table.
    wall_s
        Time it took.
    resumed
        How many of the runs were finished by an earlier comparison.
    others
        Further problems.
    """

    problem: Problem | SystemProblem
    runs: tuple[RunSummary, ...]
    rows: tuple[Row, ...]
    wall_s: float
    resumed: int = 0
    others: tuple[Problem | SystemProblem, ...] = ()

    __repr__ = short_repr

    def save(self, folder: Path | str, *, parquet: bool = False) -> None:
        """Save the comparison as a folder that :func:`planopt.load_result` reads.

        Parameters
        ----------
        folder
            Made if it is missing; a comparison that it had is replaced.
        parquet
            Whether the runs are saved as ``runs.parquet`` as well, which needs pyarrow.

        Raises
        ------
        OutputError
            The folder cannot be written; what it had is still there.
        InputError
            A problem has parts from Python, which no file can hold, or pyarrow is missing.
        """
        from planopt.studies.comparison_files import save_comparison

        save_comparison(self, path_of("folder", folder, A_FOLDER), parquet=parquet)

    def to_dataframe(self) -> Any:
        """Return the runs as a pandas DataFrame: a row a run, a column a setting and metric.

        Raises
        ------
        InputError
            pandas is not installed.
        """
        from planopt.planning.files.steps_file import require_pandas
        from planopt.studies.comparison_files import run_columns

        return require_pandas().DataFrame(run_columns(self))

    @property
    def reliability(self) -> tuple[ReliabilityBin, ...]:
        """Predicted against true connection over the steps of all runs of all settings."""
        return runs_reliability(self.runs)


def runs_reliability(runs: Sequence[RunSummary]) -> tuple[ReliabilityBin, ...]:
    """Tabulate predicted against true connection over the steps of runs.

    Runs of one seed share a channel and are one group, whatever their settings.
    """
    seeds = [np.full(len(run.connectivity), run.seed, dtype=np.intp) for run in runs]
    return reliability(
        np.concatenate([run.connectivity for run in runs]),
        np.concatenate([run.connected for run in runs]),
        np.concatenate(seeds),
    )


def runs_by_setting(runs: Sequence[RunSummary]) -> list[list[RunSummary]]:
    """Divide runs by their settings, in the order in which these occur."""
    found: dict[Hashable, list[RunSummary]] = {}
    for run in runs:
        found.setdefault(setting_of(run), []).append(run)
    return list(found.values())


def setting_of(one: RunSummary | Row) -> tuple[str, str, str | None, str, int]:
    """Return what tells settings apart: problem, sweep, cost to go, planner and horizon."""
    return one.problem, sweep_words(one), one.cost_to_go, one.planner, one.horizon


def has_horizon(one: RunSummary | Row) -> bool:
    """Return whether a setting's horizon matters: bounds foresee the whole run, whatever it is."""
    kind = OWN.get(one.planner)
    return kind is None or not kind.foresees


def sweep_words(
    one: RunSummary | Row, left_out: str | None = None, names: Mapping[str, str] | None = None
) -> str:
    """Return the changed keys of a setting with their values, in words."""
    called = names or {}
    return ", ".join(
        f"{called.get(key, key)} = {value}" for key, value in one.sweep.items() if key != left_out
    )


def setting_words(
    one: RunSummary | Row, names: Mapping[str, str], *, several_problems: bool
) -> str:
    """Return a setting in words; parameters as of :func:`sweep_words`."""
    own = {
        "objective.cost_to_go": one.cost_to_go and f"{one.cost_to_go} cost to go",
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
    """Return the swept keys with as many of their last parts as tell them apart."""
    keys = list(dict.fromkeys(key for one in settings for key in one.sweep))
    if len(keys) < 2:
        return {key: key for key in keys}
    ends = {key: [key.split(".")[-n:] for n in range(1, key.count(".") + 2)] for key in keys}
    return {
        key: ".".join(
            next(
                end
                for end in ends[key]
                if end == ends[key][-1] or sum(end in ends[other] for other in keys) == 1
            )
        )
        for key in keys
    }
