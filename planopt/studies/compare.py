"""Compare settings of problems in closed loop, on the same seeds: horizons, planners, any keys."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, cast

import numpy as np

from planopt.errors import NoPlanError
from planopt.parts import parts_of
from planopt.planning.learn import Prepared, prepare
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.loop.log import Outcome
from planopt.planning.run_summary import RunSummary, summary_of
from planopt.planning.scene import Scene, build_scenes
from planopt.problems.problem import Problem
from planopt.problems.tasks import TaskProblem, problem_from, task_of
from planopt.studies.comparison import Comparison
from planopt.studies.comparison_rows import NOT_DONE, comparison_rows
from planopt.studies.study import FinishedRuns, Study, run_key, run_study
from planopt.studies.variants import (
    AnyProblem,
    Lists,
    TaskRun,
    chosen_seeds,
    default_seeds,
    own_settings,
    several,
    swept_values,
    variants_of,
)


def compare(
    problems: AnyProblem | Sequence[AnyProblem],
    horizons: int | Sequence[int] | None = None,
    *,
    planners: str | Sequence[str] | None = None,
    costs_to_go: str | Sequence[str] | None = None,
    sweep: Mapping[str, Any] | None = None,
    seeds: int | Iterable[int] | None = None,
    workers: int = 1,
    backend: str = "loky",
    on_run: Callable[[RunSummary], None] | None = None,
    finished: Path | str | None = None,
) -> Comparison:
    """Run every setting of every problem on every seed and tabulate.

    Parameters
    ----------
    problems
        One or several, with different names, of tasks that can be simulated.
    horizons, planners, costs_to_go
        In place of the problems' own, which are kept if not given. Costs to go are both where
        there is a goal unless given, and cannot be given where there is none.
    sweep
        Values of any further keys of the problem files, by dotted key such as
        ``constraints.p_min`` or ``robots[*].speed_max_m_s``. The settings are the product of all.
        Where one problem and no setting is given, its own table ``compare`` says what is run.
    seeds
        The seeds, or how many (0, 1, ...); by default those of the table ``compare`` where that
        is run, else 30. Every setting sees the same ones. Ratios and differences
        are paired by seed with the first setting of the same problem; with that of the first
        problem if each has only one.
    workers
        Processes; a task is one seed of one problem, on one BLAS thread. The result does not depend
        on their number, but for the measured times.
    backend
        Where they run: ``loky`` (this machine), ``dask`` or ``ray``.
    on_run
        Called for every finished run, for progress display.
    finished
        Folder in which every run is kept when it is finished
        (:mod:`planopt.studies.study`). A run that an earlier comparison has kept there
        is taken from it, with the times measured then.

    Returns
    -------
    Comparison
        Runs and table.

    Raises
    ------
    InputError
        There is nothing to compare, a seed is no whole number, negative or twice there, there is
        no worker or no such backend, a value is not allowed, or runs of a problem with parts from
        Python are to be kept.
    NoPlanError
        No run has a plan, since obstacles cut every goal off.

    Examples
    --------
    >>> import planopt
    >>> found = planopt.compare(
    ...     planopt.load("open_field"), [2], costs_to_go=["geodesic"],
    ...     sweep={"constraints.p_min": [0.5, 0.9]}, seeds=1,
    ... )
    >>> [(run.sweep["constraints.p_min"], run.outcome) for run in found.runs]
    [(0.5, 'reached'), (0.9, 'reached')]
    """
    begun = perf_counter()
    kind = cast("type[AnyProblem]", Problem | TaskProblem)
    given = parts_of("problems", problems, kind, "load or make a Problem")
    own = several(horizons), several(planners), several(costs_to_go)
    lists = Lists(*own, swept_values(sweep))
    variants = variants_of(given, lists)
    if seeds is None:
        seeds = default_seeds(own_settings(given, lists))
    chosen = chosen_seeds(seeds)
    kept = None if finished is None else FinishedRuns(Path(finished))
    study: Study[_Asked, Shared, RunSummary] = Study(
        kind=RunSummary,
        prepare=_shared,
        work=_drive,
        key=_key,
    )
    places = [(variant, seed) for seed in chosen for variant in range(len(variants))]
    groups = [[(each, seed) for each in variants[variant].asked] for variant, seed in places]
    results = run_study(study, groups, workers=workers, backend=backend, record=kept)
    driven: dict[tuple[int, int, int], RunSummary] = {}
    resumed = 0
    for (number, seed), runs in zip(places, results, strict=True):
        variant = variants[number]
        for setting, run in enumerate(runs):
            resumed += run.resumed
            # A record does not know which study it is read for.
            done = replace(run.result, problem=variant.problem.name, sweep=variant.sweep)
            driven[number, setting, seed] = done
            if on_run is not None:
                on_run(done)
    ordered = [
        driven[number, setting, seed]
        for number, variant in enumerate(variants)
        for setting in range(len(variant.asked))
        for seed in chosen
    ]
    if all(run.outcome == Outcome.NO_PLAN for run in ordered):
        raise NoPlanError(ordered[0].reason)
    return Comparison(
        problem=given[0],
        runs=tuple(ordered),
        rows=tuple(comparison_rows(ordered)),
        wall_s=perf_counter() - begun,
        resumed=resumed,
        others=tuple(given[1:]),
    )


def exit_code(comparison: Comparison) -> int:
    """Return 0 if all did what was asked with every step verified, 3 if some step was not, or 4."""
    return max(run.exit_code for run in comparison.runs)


_Asked = tuple[Problem | TaskRun, int]
"""A problem with the settings of a run, and its seed."""

Shared = tuple[Prepared, tuple[Scene, ...] | None] | NoPlanError | None
"""First belief of a seed, and the scenes where there are goals: the same for all settings.

The error if there provably is no plan; None for tasks other than motion planning.
"""


def _shared(asked: _Asked) -> Shared:
    problem, seed = asked
    if isinstance(problem, TaskRun):
        return None
    prepared = prepare(problem, seed)
    try:
        return prepared, build_scenes(problem)
    except NoPlanError as error:
        return error


def _key(asked: _Asked) -> dict[str, Any]:
    problem, seed = asked
    if isinstance(problem, TaskRun):
        return run_key(problem.tables, seed)
    return run_key(problem, seed)


def _drive(asked: _Asked, shared: Shared) -> RunSummary:
    """Drive a closed loop and summarise it."""
    problem, seed = asked
    if isinstance(problem, TaskRun):
        return _drive_task(problem, seed)
    try:
        if shared is None or isinstance(shared, NoPlanError):
            raise shared or AssertionError("nothing was prepared")
        prepared, scenes = shared
        return summary_of(simulate(problem, seed=seed, scenes=scenes, prepared=prepared))
    except NoPlanError as error:
        settings = problem.planner.horizon, problem.planner.name, problem.cost_to_go
        return _summary(settings, seed, Outcome.NO_PLAN.value, str(error), NOT_DONE)


def _drive_task(asked: TaskRun, seed: int) -> RunSummary:
    """Simulate a problem of a task other than motion planning, and summarise the run."""
    problem = problem_from(asked.tables, folder=Path.cwd(), file=None)
    settings = asked.horizon, asked.planner, None
    try:
        result = task_of(problem).run(problem, seed=seed)
    except NoPlanError as error:
        return _summary(settings, seed, Outcome.NO_PLAN.value, str(error), NOT_DONE)
    data, rate = result.data, result.data.get("verified_rate")
    return replace(
        _summary(
            settings,
            seed,
            str(data["outcome"]),
            str(data.get("reason", data.get("message", ""))),
            result.exit_code,
        ),
        metrics=_numbers(data.get("metrics", {})),
        rungs={str(name): int(count) for name, count in data.get("rungs", {}).items()},
        verified_rate=np.nan if rate is None else float(rate),
        step_s=np.asarray(result.step_s, dtype=float),
    )


def _numbers(metrics: Mapping[str, Any]) -> dict[str, float]:
    """Return metrics as numbers; those of nested tables are named by both keys."""
    found: dict[str, float] = {}
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            parts = _numbers(cast("Mapping[str, Any]", value))
            found |= {f"{name}_{key}": part for key, part in parts.items()}
        else:
            found[name] = np.nan if value is None else float(value)
    return found


def _summary(
    settings: tuple[int, str, str | None], seed: int, outcome: str, reason: str, code: int
) -> RunSummary:
    """A run of no step."""
    return RunSummary(
        *settings,
        seed=seed,
        outcome=outcome,
        reason=reason,
        exit_code=code,
        metrics={},
        rungs={},
        verified_rate=np.nan,
        step_s=np.zeros(0),
        connectivity=np.zeros(0),
        connected=np.zeros(0, dtype=np.bool_),
    )
