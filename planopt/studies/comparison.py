"""A paired comparison of horizons, planners and costs to go over the same seeds: its data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planopt.channel.validation.calibration import ReliabilityBin, reliability
from planopt.planning.run import RunSummary
from planopt.problems.problem import Problem
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
        Share of released steps that were verified, over all runs.
    p50_step_s, p95_step_s
        Median and 95 % quantile of the planning time of a step, over all runs.
    paired_difference, difference_low, difference_high
        Mean over seeds of this metric less that of the reference setting, where both exist, and
        its 95 % Student interval; None if there is none. Metrics in dB have no ratios.
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
    verified_rate: float
    p50_step_s: float
    p95_step_s: float
    paired_difference: float | None = None
    difference_low: float | None = None
    difference_high: float | None = None


@dataclass(frozen=True)
class Comparison:
    """All runs of a comparison and the table made of them.

    Attributes
    ----------
    problem
        As given; horizon, planner and cost to go are those of each run.
    runs
        In the order setting by setting, seed by seed; of a sum of terms, all robots together.
    rows
        The table.
    wall_s
        Time it took.
    resumed
        How many of the runs were finished by an earlier comparison.
    """

    problem: Problem
    runs: tuple[RunSummary, ...]
    rows: tuple[Row, ...]
    wall_s: float
    resumed: int = 0

    __repr__ = short_repr

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
    """Divide runs by horizon, planner and cost to go, in the order in which these occur."""
    found: dict[tuple[int, str, str | None], list[RunSummary]] = {}
    for run in runs:
        found.setdefault((run.horizon, run.planner, run.cost_to_go), []).append(run)
    return list(found.values())
