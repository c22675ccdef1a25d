"""Closed-loop comparison of horizons, planners and other settings on common seeds."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any, cast

import numpy as np

from planopt.errors import InputError, NoPlanError
from planopt.parts import parts_of
from planopt.planning.loop.log import Outcome
from planopt.planning.loop.results import NOT_DONE, RunSummary
from planopt.problems.load import with_changes
from planopt.problems.problem import Problem
from planopt.problems.settings import DEFAULT_SEEDS, ComparisonSettings, require_swept, seeds_of
from planopt.problems.tasks import TaskProblem, task_of
from planopt.studies.comparison import Comparison, comparison_rows
from planopt.studies.study import AnyProblem, FinishedRuns, Study, run_key, run_study, shared_data

Item = tuple[AnyProblem, int]
"""Problem with the settings of a run, and seed of the run."""


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
    """Simulate every setting of every problem on every seed; return the runs and a table.

    Parameters
    ----------
    problems
        One or several problems with different names. Designs, which cannot be simulated, are
        solved.
    horizons, planners, costs_to_go
        Values to compare; None keeps the problems' own. By default, problems with a goal are
        compared with both costs-to-go; others have none.
    sweep
        Values of other problem file keys, by dotted key such as ``constraints.p_min`` or
        ``robots[*].speed_max_m_s``. All combinations of settings are run. A single problem without
        any setting is compared as specified in its table ``compare``.
    seeds
        Random seeds, or their number (0, 1, ...). Defaults to those of the table ``compare`` if it
        is used, else 30, or 1 for designs. Every setting uses the same seeds. Ratios and
        differences are paired by seed with the first setting of the same problem, or of the first
        problem if each has only one setting.
    workers
        Number of processes; each runs one seed of one problem on one BLAS thread. Only measured
        times depend on it.
    backend
        Backend of the processes: ``loky`` (this machine), ``dask`` or ``ray``.
    on_run
        Function called after every finished run, for progress display.
    finished
        Folder for finished runs (:mod:`planopt.studies.study`). Runs stored there by an earlier
        comparison are reused, with the times measured then.

    Returns
    -------
    Comparison
        Runs, and table of their metrics.

    Raises
    ------
    InputError
        No settings to compare; a seed is negative, repeated or not an integer; a value or backend
        is unknown; or a run with parts from Python cannot be stored.
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
    compared = parts_of("problems", problems, kind, "use planopt.load, or create a Problem")
    own = several(horizons), several(planners), several(costs_to_go)
    lists = Lists(*own, swept_values(sweep))
    variants = variants_of(compared, lists)
    if seeds is None:
        seeds = default_seeds(own_settings(compared, lists), compared)
    chosen = chosen_seeds(seeds)
    kept = None if finished is None else FinishedRuns(Path(finished))
    study: Study[Item, Any, RunSummary] = Study(
        kind=RunSummary, prepare=shared_data, work=_drive, key=lambda item: run_key(*item)
    )
    places = [(variant, seed) for seed in chosen for variant in range(len(variants))]
    groups = [[(each, seed) for each in variants[variant].settings] for variant, seed in places]
    results = run_study(study, groups, workers=workers, backend=backend, record=kept)
    driven: dict[tuple[int, int, int], RunSummary] = {}
    resumed = 0
    for (number, seed), runs in zip(places, results, strict=True):
        variant = variants[number]
        for setting, (run, was_finished) in enumerate(runs):
            resumed += was_finished
            # Stored runs contain neither the problem's name nor the changed keys of this study.
            done = replace(run, problem=variant.problem.name, sweep=variant.sweep)
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


def _drive(item: Item, shared: Any) -> RunSummary:
    """Return the summary of a simulated run of one setting."""
    problem, seed = item
    task = task_of(problem)
    try:
        if isinstance(shared, NoPlanError):
            raise shared
        return task.run_summary(problem, seed, shared)
    except NoPlanError as error:
        return RunSummary(
            *task.labels(problem),
            seed=seed,
            outcome=Outcome.NO_PLAN.value,
            reason=str(error),
            exit_code=NOT_DONE,
        )


OWN_OPTIONS = {
    "planner.horizon": "horizons",
    "planner.name": "planners",
    "objective.cost_to_go": "costs_to_go",
}
"""Keys for which :func:`compare` has a separate argument; a sweep may contain them instead."""


@dataclass(frozen=True)
class Variant:
    """Problem with the changes of a sweep, and the settings to run."""

    problem: AnyProblem
    sweep: Mapping[str, Any]
    settings: tuple[AnyProblem, ...]


@dataclass(frozen=True)
class Lists:
    """Lists of values to combine; None means the problem's own value."""

    horizons: Sequence[int] | None = None
    planners: Sequence[str] | None = None
    costs_to_go: Sequence[str] | None = None
    sweep: Mapping[str, Sequence[Any]] | None = None


def settings_of(problems: Sequence[AnyProblem], lists: Lists) -> list[AnyProblem]:
    """Return the settings that :func:`planopt.compare` runs on each seed; raise the same errors."""
    return [each for variant in variants_of(problems, lists) for each in variant.settings]


def own_settings(problems: Sequence[AnyProblem], lists: Lists) -> ComparisonSettings | None:
    """Return the table ``compare`` of a single problem; None if `lists` has any values."""
    if len(problems) > 1 or lists != Lists():
        return None
    return getattr(problems[0], "compare", None)


def default_seeds(own: ComparisonSettings | None, problems: Sequence[AnyProblem] = ()) -> range:
    """Return the default seeds; one seed for designs, which contain nothing random."""
    if problems and all(task_of(problem).simulate is None for problem in problems):
        return range(1)
    return seeds_of(DEFAULT_SEEDS if own is None else own.seeds, "compare.seeds")


def several(values: object) -> Sequence[Any] | None:
    """Return one or several values as a sequence, and None unchanged."""
    if values is None:
        return None
    if isinstance(values, str | Mapping) or not isinstance(values, Iterable):
        return [cast("object", values)]
    return list(cast("Iterable[object]", values))


def swept_values(sweep: object) -> Mapping[str, Sequence[Any]] | None:
    """Return the swept values of each key as sequences; None without a sweep."""
    if sweep is None:
        return None
    if not isinstance(sweep, Mapping):
        raise InputError(
            f"is of type {type(sweep).__name__}, should be a dictionary of lists",
            key="sweep",
            remedy='give the values of each key, e.g. {"constraints.p_min": [0.5, 0.9]}',
        )
    swept = cast("Mapping[str, object]", sweep)
    for key in swept:
        require_swept(str(key))
    return {key: several(values) or [] for key, values in swept.items()}


def chosen_seeds(seeds: object) -> list[int]:
    """Return the given list of seeds, or the seeds 0 to n - 1 for a number n."""

    def is_whole(value: object) -> bool:
        return isinstance(value, int | np.integer) and not isinstance(value, bool)

    if is_whole(seeds):
        seeds = range(cast("int", seeds))
    is_list = isinstance(seeds, Iterable) and not isinstance(seeds, str | Mapping)
    chosen: list[Any] = list(cast("Iterable[Any]", seeds)) if is_list else [seeds]
    for number, seed in enumerate(chosen):
        if not is_whole(seed) or seed < 0 or seed in chosen[:number]:
            raise InputError(
                f"is {seed!r}, should be a whole number of at least 0 that occurs only once",
                key=f"seeds[{number}]" if is_list and not is_whole(seed) else "seeds",
                remedy="give a number of seeds such as 30, or a list or range of seeds such as "
                "range(100, 200)",
            )
    if not chosen:
        raise InputError("is empty", key="seeds", remedy="give a number of seeds, such as 30")
    return [int(seed) for seed in chosen]


def variants_of(problems: Sequence[AnyProblem], lists: Lists) -> list[Variant]:
    """Return every combination of problem and swept values, with validated settings."""
    for key, values in {"problems": problems, **vars(lists), **(lists.sweep or {})}.items():
        if key != "sweep" and values is not None and len(values) == 0:
            raise InputError(
                "is empty, so that there is nothing to compare",
                key=key,
                remedy="give at least one value, or leave it out",
            )
    names = [problem.name for problem in problems]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"has several problems with the name {name}",
                key="problems",
                remedy="give each problem its own name",
            )
    table = own_settings(problems, lists)
    if table is None:
        return _product(problems, lists)
    found: list[Variant] = []
    for number, group in enumerate(table.settings):
        where: dict[str, Any] = {"file": problems[0].file, "key": f"compare.settings[{number}]"}
        own = (group.horizons or None, group.planners or None, group.costs_to_go or None)
        try:
            found += _product(problems, Lists(*own, group.sweep))
        except InputError as error:
            message = str(InputError(error.message, key=error.key))
            raise InputError(message, remedy=error.remedy, **where) from error
        settings = [
            (each.sweep, *task_of(one).labels(one)) for each in found for one in each.settings
        ]
        if any(setting in settings[:n] for n, setting in enumerate(settings)):
            raise InputError("contains a setting twice", remedy="remove the duplicate", **where)
    return found


def _product(problems: Sequence[AnyProblem], lists: Lists) -> list[Variant]:
    """Return one variant for each combination of the listed values."""
    swept = dict(lists.sweep or {})
    for key, option in OWN_OPTIONS.items():
        if key in swept and getattr(lists, option) is not None:
            raise InputError(
                f"is swept, but is also set by {option}", key=key, remedy="use only one of both"
            )
    variants: list[Variant] = []
    for problem, values in product(problems, product(*swept.values())):
        changes = dict(zip(swept, values, strict=True))
        changed = with_changes(problem, changes)
        costs: Sequence[str | None] = lists.costs_to_go or (None,)
        if lists.costs_to_go is None and "objective.cost_to_go" not in swept:
            costs = task_of(changed).compared_costs_to_go(changed)
        variants.append(Variant(changed, changes, _settings(changed, costs, lists)))
    return variants


def _settings(
    problem: AnyProblem, costs: Sequence[str | None], lists: Lists
) -> tuple[AnyProblem, ...]:
    """Return a problem's distinct combinations of cost-to-go, planner and horizon."""
    task = task_of(problem)
    if task.simulate is None and task.solve is None:
        raise InputError(
            f"is {problem.task}, which has no simulated runs to compare",
            file=problem.file,
            key="problem.task",
            remedy="use planopt solve, or compare problems of another task",
        )
    found: dict[tuple[object, ...], AnyProblem] = {}
    for cost, planner, horizon in product(
        costs, lists.planners or (None,), lists.horizons or (None,)
    ):
        one = task.overridden(problem, horizon=horizon, planner=planner, cost_to_go=cost)
        own_horizon, *others = task.labels(one)
        # Planners with a full-run horizon produce the same plan for every horizon.
        found.setdefault((own_horizon if task.has_horizon(one) else None, *others), one)
    return tuple(found.values())
