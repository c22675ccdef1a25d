"""Compare settings of problems in closed loop, on the same seeds: horizons, planners, any keys."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.validation.calibration import FEWEST_GROUPS
from planopt.errors import InputError, NoPlanError
from planopt.parts import parts_of
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.loop.log import Outcome
from planopt.planning.loop.metrics import ANY, POSSIBLE
from planopt.planning.prepare import Prepared, prepare
from planopt.planning.run import RunSummary, summary_of
from planopt.planning.scene import Scene, build_scenes
from planopt.problems.comparison_settings import (
    DEFAULT_SEEDS,
    ComparisonSettings,
    require_swept,
    seeds_of,
)
from planopt.problems.overrides import with_changes, with_overrides
from planopt.problems.planner_kinds import planner_kind
from planopt.problems.problem import Problem
from planopt.problems.systems import Request, SystemProblem, system_from_tables
from planopt.studies.comparison import Comparison, Row, runs_by_setting
from planopt.studies.study import FinishedRuns, Study, run_key, run_study

CONFIDENCE = 0.95

NOT_DONE, NOT_VERIFIED = 4, 3
"""Exit codes of runs."""

OWN_OPTIONS = {
    "planner.horizon": "horizons",
    "planner.name": "planners",
    "objective.cost_to_go": "costs_to_go",
}
"""Keys that have an argument of their own; a sweep may have them in its place."""

AnyProblem = Problem | SystemProblem


@dataclass(frozen=True)
class SystemRun:
    """A run of a system's problem, as plain data that any process can rebuild it from."""

    name: str
    tables: Mapping[str, Any]
    horizon: int
    planner: str


@dataclass(frozen=True)
class _Variant:
    """One problem with what was changed of it, and its settings as they are run."""

    problem: AnyProblem
    sweep: Mapping[str, Any]
    asked: tuple[Problem | SystemRun, ...]


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
        One or several, with different names; of motion planning, or of systems with runs.
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
    kind = cast("type[AnyProblem]", Problem | SystemProblem)
    given = parts_of("problems", problems, kind, "load or make a Problem")
    asked = _several(horizons), _several(planners), _several(costs_to_go), _swept(sweep)
    variants = _variants(given, *asked)
    if seeds is None:
        seeds = default_seeds(own_settings(given, *asked))
    chosen = _chosen_seeds(seeds)
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


def settings_of(
    problems: Sequence[AnyProblem],
    horizons: Sequence[int] | None = None,
    planners: Sequence[str] | None = None,
    costs_to_go: Sequence[str] | None = None,
    sweep: Mapping[str, Sequence[Any]] | None = None,
) -> list[Problem | SystemRun]:
    """Return every setting that :func:`compare` runs on each seed; errors as there."""
    variants = _variants(problems, horizons, planners, costs_to_go, sweep)
    return [asked for variant in variants for asked in variant.asked]


def own_settings(
    problems: Sequence[AnyProblem], *given: Sequence[Any] | Mapping[str, Any] | None
) -> ComparisonSettings | None:
    """Return the table ``compare`` of a problem that is alone and `given` no settings, or None."""
    (first, *others) = problems
    if others or not isinstance(first, Problem) or any(each is not None for each in given):
        return None
    return first.compare


def default_seeds(own: ComparisonSettings | None) -> range:
    """Return the seeds where none are given: those of the table ``compare`` that is run."""
    return seeds_of(DEFAULT_SEEDS if own is None else own.seeds, "compare.seeds")


def _several(values: object) -> Sequence[Any] | None:
    """Return several values; a single one, such as a name, as a list of it."""
    if values is None:
        return None
    if isinstance(values, str | Mapping) or not isinstance(values, Iterable):
        return [cast("object", values)]
    return list(cast("Iterable[object]", values))


def _swept(sweep: object) -> Mapping[str, Sequence[Any]] | None:
    """Return the swept values of each key.

    Raises
    ------
    InputError
        It is no mapping.
    """
    if sweep is None:
        return None
    if not isinstance(sweep, Mapping):
        raise InputError(
            f"is a {type(sweep).__name__}",
            key="sweep",
            remedy='give the values of each key, {"constraints.p_min": [0.5, 0.9]}',
        )
    swept = cast("Mapping[str, object]", sweep)
    for key in swept:
        require_swept(str(key))
    return {key: _several(values) or [] for key, values in swept.items()}


def _chosen_seeds(seeds: object) -> list[int]:
    """Return the seeds that are asked for, or as many of them.

    Raises
    ------
    InputError
        They are no whole numbers, negative or repeated, or there is none.
    """
    remedy = "a number of seeds such as 30, or seeds such as [0, 1] or range(100, 200)"
    if isinstance(seeds, int | np.integer) and not isinstance(seeds, bool):
        seeds = range(int(cast("int", seeds)))
    if isinstance(seeds, str | Mapping) or not isinstance(seeds, Iterable):
        raise InputError(
            f"is {seeds!r}, should be whole numbers, at least 0", key="seeds", remedy=remedy
        )
    chosen: list[int] = []
    for number, seed in enumerate(cast("Iterable[object]", seeds)):
        if not isinstance(seed, int | np.integer) or isinstance(seed, bool):
            raise InputError(
                f"is {seed!r}, should be a whole number, at least 0",
                key=f"seeds[{number}]",
                remedy=remedy,
            )
        chosen.append(int(cast("int", seed)))
    if not chosen:
        raise InputError(
            "there is none, so nothing to compare",
            key="seeds",
            remedy="give a number of seeds, such as 30",
        )
    if min(chosen) < 0 or len(set(chosen)) < len(chosen):
        raise InputError(
            f"{chosen} has a negative or repeated seed", key="seeds", remedy="0, 1, ..."
        )
    return chosen


def _variants(
    problems: Sequence[AnyProblem],
    horizons: Sequence[int] | None,
    planners: Sequence[str] | None,
    costs_to_go: Sequence[str] | None,
    sweep: Mapping[str, Sequence[Any]] | None,
) -> list[_Variant]:
    """Every problem under every combination of the swept values, with its checked settings."""
    own = {"horizons": horizons, "planners": planners, "costs_to_go": costs_to_go}
    for key, values in {"problems": problems, **own, **(sweep or {})}.items():
        if values is not None and len(values) == 0:
            raise InputError(
                "there is none, so nothing to compare",
                key=key,
                remedy="give one value at least, or leave it out",
            )
    names = [problem.name for problem in problems]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"several are called {name}", key="problems", remedy="give each a name of its own"
            )
    table = own_settings(problems, horizons, planners, costs_to_go, sweep)
    if table is None:
        return _variants_of(problems, horizons, planners, costs_to_go, sweep)
    found: list[_Variant] = []
    for number, group in enumerate(table.settings):
        lists = group.horizons or None, group.planners or None, group.costs_to_go or None
        try:
            found += _variants_of(problems, *lists, group.sweep)
        except InputError as error:
            raise InputError(
                error.message if error.key is None else f"{error.key} {error.message}",
                file=problems[0].file,
                key=f"compare.settings[{number}]",
                remedy=error.remedy,
            ) from error
        settings = [(each.sweep, *_labels(asked)) for each in found for asked in each.asked]
        if any(setting in settings[:n] for n, setting in enumerate(settings)):
            raise InputError(
                "has a setting that is there twice",
                file=problems[0].file,
                key=f"compare.settings[{number}]",
                remedy="leave it out",
            )
    return found


def _labels(asked: Problem | SystemRun) -> tuple[int, str, str | None]:
    """Horizon, planner and cost-to-go of a setting."""
    if isinstance(asked, SystemRun):
        return asked.horizon, asked.planner, None
    return asked.planner.horizon, asked.planner.name, asked.cost_to_go


def _variants_of(
    problems: Sequence[AnyProblem],
    horizons: Sequence[int] | None,
    planners: Sequence[str] | None,
    costs_to_go: Sequence[str] | None,
    sweep: Mapping[str, Sequence[Any]] | None,
) -> list[_Variant]:
    """The product of all lists."""
    swept = dict(sweep or {})
    own = {"horizons": horizons, "planners": planners, "costs_to_go": costs_to_go}
    for key, option in OWN_OPTIONS.items():
        if key in swept and own[option] is not None:
            raise InputError(f"is swept, and given as {option}", key=key, remedy="give it once")
    variants: list[_Variant] = []
    for problem, values in product(problems, product(*swept.values())):
        changes = dict(zip(swept, values, strict=True))
        changed = with_changes(problem, changes)
        asked = (
            _system_runs(changed, horizons, planners, costs_to_go)
            if isinstance(changed, SystemProblem)
            else _motion_runs(changed, horizons, planners, costs_to_go, swept)
        )
        variants.append(_Variant(changed, changes, tuple(asked)))
    return variants


def _motion_runs(
    problem: Problem,
    horizons: Sequence[int] | None,
    planners: Sequence[str] | None,
    costs_to_go: Sequence[str] | None,
    swept: Mapping[str, Sequence[Any]],
) -> list[Problem]:
    costs: Sequence[str | None] = costs_to_go or (None,)
    if costs_to_go is None and "objective.cost_to_go" not in swept:
        costs = default_costs_to_go(problem)
    return [
        with_overrides(problem, horizon=n, planner=p, cost_to_go=c)
        for c in costs
        for p in planners or (None,)
        for n in _horizons_of(p or problem.planner.name, horizons or (None,))
    ]


def _horizons_of(planner: str, horizons: Sequence[int | None]) -> Sequence[int | None]:
    """Return those that matter to a planner: bounds foresee the whole run whatever the horizon."""
    return horizons[:1] if planner_kind(planner).foresees else horizons


def default_costs_to_go(problem: Problem) -> tuple[str | None, ...]:
    """Return the costs-to-go compared by default: both where there is a goal."""
    return ("geodesic", "connected") if problem.task == "reach" else (None,)


def _system_runs(
    problem: SystemProblem,
    horizons: Sequence[int] | None,
    planners: Sequence[str] | None,
    costs_to_go: Sequence[str] | None,
) -> list[SystemRun]:
    if costs_to_go is not None:
        raise InputError(
            f"is not for the task {problem.task}", key="costs_to_go", remedy="leave it out"
        )
    if problem.system.settings is None:
        raise InputError(
            f"{problem.name} asks for {problem.task}, which has no runs to compare",
            file=problem.file,
            key="problem.task",
            remedy="compare problems of motion planning, or pursuits",
        )
    request = Request(horizons=horizons or (), planners=planners or ())
    tables = problem.tables()
    return [
        SystemRun(problem.name, tables, horizon, planner)
        for horizon, planner in problem.system.settings(problem, request)
    ]


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


_Asked = tuple[Problem | SystemRun, int]
"""A problem with the settings of a run, and its seed."""

Shared = tuple[Prepared, tuple[Scene, ...] | None] | NoPlanError | None
"""First belief of a seed, and the scenes where there are goals: the same for all settings.

The error if there provably is no plan, and nothing for systems.
"""


def _shared(asked: _Asked) -> Shared:
    problem, seed = asked
    if isinstance(problem, SystemRun):
        return None
    prepared = prepare(problem, seed)
    try:
        return prepared, build_scenes(problem)
    except NoPlanError as error:
        return error


def _key(asked: _Asked) -> dict[str, Any]:
    problem, seed = asked
    if isinstance(problem, SystemRun):
        settings = {"horizon": problem.horizon, "planner": problem.planner}
        return {**run_key(problem.tables, seed), **settings}
    return run_key(problem, seed)


def _drive(asked: _Asked, shared: Shared) -> RunSummary:
    """Drive a closed loop and summarise it."""
    problem, seed = asked
    if isinstance(problem, SystemRun):
        return _drive_system(problem, seed)
    try:
        if shared is None or isinstance(shared, NoPlanError):
            raise shared or AssertionError("nothing was prepared")
        prepared, scenes = shared
        return summary_of(simulate(problem, seed=seed, scenes=scenes, prepared=prepared))
    except NoPlanError as error:
        settings = problem.planner.horizon, problem.planner.name, problem.cost_to_go
        return _summary(settings, seed, Outcome.NO_PLAN.value, str(error), NOT_DONE)


def _drive_system(asked: SystemRun, seed: int) -> RunSummary:
    problem = system_from_tables(asked.tables, folder=Path.cwd(), file=None)
    if problem is None:
        raise AssertionError(f"{asked.name} is no system's")
    horizons, planners = (asked.horizon,), (asked.planner,)
    request = Request(seed, horizons, planners)
    answer = problem.answer("simulate", request)
    data = answer.data
    return replace(
        _summary(
            (asked.horizon, asked.planner, None),
            seed,
            str(data["outcome"]),
            str(data.get("reason", data.get("message", ""))),
            answer.exit_code,
        ),
        metrics=_numbers(data["metrics"]),
        rungs={str(name): int(count) for name, count in data["rungs"].items()},
        verified_rate=np.nan if data["verified_rate"] is None else float(data["verified_rate"]),
        step_s=np.asarray(answer.step_s, dtype=float),
    )


def _numbers(metrics: Mapping[str, Any]) -> dict[str, float]:
    """Metrics of a system as numbers; those of tables are named by both keys."""
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
