"""Compare horizons, planners and costs to go in closed loop, on the same seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.validation.calibration import FEWEST_GROUPS
from planopt.errors import InputError
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.loop.metrics import ANY, POSSIBLE
from planopt.planning.prepare import Prepared, prepare
from planopt.planning.run import ARRIVED, RunSummary, summary_of
from planopt.planning.scene import Scene, build_scenes
from planopt.problems.overrides import require_motion, with_overrides
from planopt.problems.problem import Problem
from planopt.studies.comparison import Comparison, Row
from planopt.studies.finished_runs import FinishedRuns, run_key
from planopt.studies.study import Study, run_study

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Setting:
    """One cell of a comparison."""

    horizon: int
    planner: str
    cost_to_go: str | None


def compare_horizons(
    problem: Problem,
    horizons: Sequence[int],
    *,
    planners: Sequence[str] = ("auto",),
    costs_to_go: Sequence[str] | None = None,
    seeds: int | Iterable[int] = 30,
    workers: int = 1,
    backend: str = "loky",
    on_run: Callable[[RunSummary], None] | None = None,
    finished: Path | None = None,
) -> Comparison:
    """Run every setting on every seed and tabulate.

    Parameters
    ----------
    problem
        What to run; horizon, planner and cost to go are overridden.
    horizons, planners, costs_to_go
        The settings are their product; the first is the reference of paired ratios. Costs to go
        are both where there is a goal unless given, and cannot be given where there is none.
    seeds
        The seeds, or how many (0, 1, ...). Every setting sees the same ones.
    workers
        Processes; a task is one seed with all settings, on one BLAS thread. The result does not
        depend on their number, but for the measured times.
    backend
        joblib backend; ``loky`` is this machine.
    on_run
        Called for every finished run, for progress display.
    finished
        Folder in which every run is kept when it is finished
        (:mod:`planopt.studies.finished_runs`). A run that an earlier comparison has kept there
        is taken from it, with the times measured then.

    Raises
    ------
    InputError
        There is nothing to compare, a seed is negative or twice there, there is no worker or no
        such backend, an override is not allowed, or runs of a problem with parts from Python are
        to be kept.
    NoPlanError
        Obstacles cut the goal off.
    """
    require_motion(problem)
    begun = perf_counter()
    chosen = list(range(seeds)) if isinstance(seeds, int) else list(seeds)
    costs = costs_to_go if costs_to_go is not None else default_costs_to_go(problem)
    _check(horizons, planners, costs, chosen)
    settings = [Setting(n, p, c) for c in costs for p in planners for n in horizons]
    kept = None if finished is None else FinishedRuns(finished)
    driven: dict[tuple[Setting, int], RunSummary] = {}
    asked = [_apply(problem, setting) for setting in settings]
    study: Study[_Asked, Shared, RunSummary] = Study(
        kind=RunSummary,
        prepare=_shared,
        work=_drive,
        key=_key,
    )
    groups = [[(each, seed) for each in asked] for seed in chosen]
    results = run_study(study, groups, workers=workers, backend=backend, record=kept)
    resumed = 0
    for seed, runs in zip(chosen, results, strict=True):
        for setting, run in zip(settings, runs, strict=True):
            resumed += run.resumed
            driven[setting, seed] = run.result
            if on_run is not None:
                on_run(run.result)
    by_setting = [[driven[setting, seed] for seed in chosen] for setting in settings]
    rows = [
        row
        for setting, runs in zip(settings, by_setting, strict=True)
        for row in tabulate(setting, runs, by_setting[0])
    ]
    return Comparison(
        problem=problem,
        runs=tuple(run for runs in by_setting for run in runs),
        rows=tuple(rows),
        wall_s=perf_counter() - begun,
        resumed=resumed,
    )


def default_costs_to_go(problem: Problem) -> tuple[str | None, ...]:
    """What is compared if nothing is said: both where there is a goal."""
    return ("geodesic", "connected") if problem.task == "reach" else (None,)


def _check(
    horizons: Sequence[int],
    planners: Sequence[str],
    costs_to_go: Sequence[str | None],
    seeds: Sequence[int],
) -> None:
    """Raise an InputError that names the argument at fault."""
    settings = {"horizons": horizons, "planners": planners, "costs_to_go": costs_to_go}
    for key, values in {**settings, "seeds": seeds}.items():
        if len(values) == 0:
            raise InputError("there is none, so nothing to compare", key=key)
    if min(seeds) < 0 or len(set(seeds)) < len(seeds):
        raise InputError(
            f"{list(seeds)} has a negative or repeated seed", key="seeds", remedy="0, 1, ..."
        )


def tabulate(
    setting: Setting, runs: Sequence[RunSummary], reference: Sequence[RunSummary]
) -> list[Row]:
    """Rows of one setting, one a metric; `reference` holds the same seeds in the same order."""
    each = [run.step_s for run in runs]
    steps = np.concatenate(each)
    verified = sum(run.verified_rate * len(times) for run, times in zip(runs, each, strict=True))
    rows: list[Row] = []
    for metric in runs[0].metrics:
        values, others = _values(runs, metric), _values(reference, metric)
        there = values[np.isfinite(values)]
        low, high = mean_interval(there, POSSIBLE.get(metric, ANY))
        differences = (values - others)[np.isfinite(values) & np.isfinite(others)]
        difference_low, difference_high = mean_interval(differences)
        rows.append(
            Row(
                horizon=setting.horizon,
                planner=setting.planner,
                cost_to_go=setting.cost_to_go,
                seeds=len(runs),
                stalled=sum(run.outcome not in ARRIVED for run in runs),
                metric=metric,
                mean=float(there.mean()) if there.size else None,
                ci_low=low,
                ci_high=high,
                count=int(there.size),
                paired_ratio=paired_ratio(values, others),
                verified_rate=float(verified / steps.size) if steps.size else 1.0,
                p50_step_s=float(np.median(steps)) if steps.size else 0.0,
                p95_step_s=float(np.quantile(steps, 0.95)) if steps.size else 0.0,
                paired_difference=float(differences.mean()) if differences.size else None,
                difference_low=difference_low,
                difference_high=difference_high,
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


def paired_ratio(values: NDArray[np.float64], others: NDArray[np.float64]) -> float | None:
    """Geometric mean of the ratios where both are positive and finite; None if there are none."""
    both = np.isfinite(values) & np.isfinite(others) & (values > 0.0) & (others > 0.0)
    if not both.any():
        return None
    return float(np.exp(np.log(values[both] / others[both]).mean()))


def _values(runs: Sequence[RunSummary], metric: str) -> NDArray[np.float64]:
    return np.array([run.metrics[metric] for run in runs], dtype=float)


def _apply(problem: Problem, setting: Setting) -> Problem:
    return with_overrides(
        problem,
        horizon=setting.horizon,
        planner=setting.planner,
        cost_to_go=setting.cost_to_go,
    )


_Asked = tuple[Problem, int]
"""A problem with the settings of a run, and its seed."""

Shared = tuple[Prepared, tuple[Scene, ...] | None]
"""First belief of a seed, and the scenes where there are goals: the same for all settings."""


def _shared(asked: _Asked) -> Shared:
    problem, seed = asked
    prepared = prepare(problem, seed)
    return prepared, build_scenes(problem)


def _key(asked: _Asked) -> dict[str, Any]:
    return run_key(*asked)


def _drive(asked: _Asked, shared: Shared) -> RunSummary:
    """Drive a closed loop and summarise it."""
    problem, seed = asked
    prepared, scenes = shared
    return summary_of(simulate(problem, seed=seed, scenes=scenes, prepared=prepared))
