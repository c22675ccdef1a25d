"""Compare settings of problems in closed loop, on the same seeds: horizons, planners, any keys."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, cast

from planopt.errors import NoPlanError
from planopt.parts import parts_of
from planopt.planning.loop.log import Outcome
from planopt.planning.run_summary import NOT_DONE, RunSummary, short_summary
from planopt.problems.problem import Problem
from planopt.problems.tasks import TaskProblem, task_of
from planopt.studies.comparison import Comparison
from planopt.studies.comparison_rows import comparison_rows
from planopt.studies.study import FinishedRuns, Study, run_key, run_study
from planopt.studies.variants import (
    AnyProblem,
    Lists,
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
    """Simulate every setting of every problem on every seed, and tabulate the runs.

    Parameters
    ----------
    problems
        One or several, with different names, of tasks that can be simulated.
    horizons, planners, costs_to_go
        Values to compare; None keeps the problems' own. Problems with a goal are compared with
        both costs-to-go by default; others have none.
    sweep
        Values of any further keys of the problem files, by dotted key such as
        ``constraints.p_min`` or ``robots[*].speed_max_m_s``. The settings are the product of all.
        One problem without any setting is compared as its own table ``compare`` says.
    seeds
        The seeds, or their number (0, 1, ...); by default those of the table ``compare`` if it
        is used, else 30. Every setting uses the same seeds. Ratios and differences are paired by
        seed with the first setting of the same problem; with that of the first problem if each
        has only one.
    workers
        Number of processes; each runs one seed of one problem on one BLAS thread. Only measured
        times depend on their number.
    backend
        Where the processes run: ``loky`` (this machine), ``dask`` or ``ray``.
    on_run
        Called for every finished run, for progress display.
    finished
        Folder that keeps every finished run (:mod:`planopt.studies.study`). Runs that an earlier
        comparison has kept there are read, with the times measured then.

    Returns
    -------
    Comparison
        Runs and table.

    Raises
    ------
    InputError
        There is nothing to compare, a seed is negative, repeated or no whole number, a value or
        backend is unknown, or a run with parts from Python cannot be kept.
    NoPlanError
        No run has a plan, for instance because obstacles cut off every goal.

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
    compared = parts_of("problems", problems, kind, "load or make a Problem")
    own = several(horizons), several(planners), several(costs_to_go)
    lists = Lists(*own, swept_values(sweep))
    variants = variants_of(compared, lists)
    if seeds is None:
        seeds = default_seeds(own_settings(compared, lists))
    chosen = chosen_seeds(seeds)
    kept = None if finished is None else FinishedRuns(Path(finished))
    study: Study[Item, Any, RunSummary] = Study(
        kind=RunSummary, prepare=_shared, work=_drive, key=lambda item: run_key(*item)
    )
    places = [(variant, seed) for seed in chosen for variant in range(len(variants))]
    groups = [[(each, seed) for each in variants[variant].settings] for variant, seed in places]
    results = run_study(study, groups, workers=workers, backend=backend, record=kept)
    driven: dict[tuple[int, int, int], RunSummary] = {}
    resumed = 0
    for (number, seed), runs in zip(places, results, strict=True):
        variant = variants[number]
        for setting, run in enumerate(runs):
            resumed += run.resumed
            # The record of a run does not contain the name and changes of this study.
            done = replace(run.result, problem=variant.problem.name, sweep=variant.sweep)
            driven[number, setting, seed] = done
            if on_run is not None:
                on_run(done)
    ordered = [
        driven[number, setting, seed]
        for number, variant in enumerate(variants)
        for setting in range(len(variant.settings))
        for seed in chosen
    ]
    if all(run.outcome == Outcome.NO_PLAN for run in ordered):
        raise NoPlanError(ordered[0].reason)
    return Comparison(
        problem=compared[0],
        runs=tuple(ordered),
        rows=tuple(comparison_rows(ordered)),
        wall_s=perf_counter() - begun,
        resumed=resumed,
        others=tuple(compared[1:]),
    )


def exit_code(comparison: Comparison) -> int:
    """Return 0 if all runs did their task, 3 if some step is not verified, 4 if some run failed."""
    return max(run.exit_code for run in comparison.runs)


Item = tuple[AnyProblem, int]
"""A problem with the settings of a run, and its seed."""


def _shared(item: Item) -> Any:
    """Return the data that all settings of one seed share; the error if there is no plan."""
    problem, seed = item
    try:
        return task_of(problem).shared(problem, seed)
    except NoPlanError as error:
        return error


def _drive(item: Item, shared: Any) -> RunSummary:
    """Simulate one setting and summarise the run."""
    problem, seed = item
    task = task_of(problem)
    try:
        if isinstance(shared, NoPlanError):
            raise shared
        return task.run_summary(problem, seed, shared)
    except NoPlanError as error:
        return short_summary(task.labels(problem), seed, Outcome.NO_PLAN, str(error), NOT_DONE)
