"""The settings and seeds of a comparison: the product of what is swept, checked before any run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, cast

import numpy as np

from planopt.errors import InputError
from planopt.problems.comparison_settings import (
    DEFAULT_SEEDS,
    ComparisonSettings,
    require_swept,
    seeds_of,
)
from planopt.problems.overrides import with_changes
from planopt.problems.problem import Problem
from planopt.problems.tasks import TaskProblem, task_of

OWN_OPTIONS = {
    "planner.horizon": "horizons",
    "planner.name": "planners",
    "objective.cost_to_go": "costs_to_go",
}
"""Keys that have an argument of their own; a sweep may have them in its place."""

AnyProblem = Problem | TaskProblem


@dataclass(frozen=True)
class Variant:
    """A problem with swept changes, and its settings."""

    problem: AnyProblem
    sweep: Mapping[str, Any]
    settings: tuple[AnyProblem, ...]


@dataclass(frozen=True)
class Lists:
    """Values whose product is run; None keeps the problem's own."""

    horizons: Sequence[int] | None = None
    planners: Sequence[str] | None = None
    costs_to_go: Sequence[str] | None = None
    sweep: Mapping[str, Sequence[Any]] | None = None


def settings_of(
    problems: Sequence[AnyProblem],
    horizons: Sequence[int] | None = None,
    planners: Sequence[str] | None = None,
    costs_to_go: Sequence[str] | None = None,
    sweep: Mapping[str, Sequence[Any]] | None = None,
) -> list[AnyProblem]:
    """Return every setting that :func:`planopt.compare` runs on each seed; errors as there."""
    variants = variants_of(problems, Lists(horizons, planners, costs_to_go, sweep))
    return [setting for variant in variants for setting in variant.settings]


def own_settings(problems: Sequence[AnyProblem], lists: Lists) -> ComparisonSettings | None:
    """Return the table ``compare`` of a single problem if there are no lists, or None."""
    (first, *others) = problems
    if others or not isinstance(first, Problem) or lists != Lists():
        return None
    return first.compare


def default_seeds(own: ComparisonSettings | None) -> range:
    """Return the seeds where none are given: those of the table ``compare`` that is run."""
    return seeds_of(DEFAULT_SEEDS if own is None else own.seeds, "compare.seeds")


def several(values: object) -> Sequence[Any] | None:
    """Return several values; a single one, such as a name, as a list of it."""
    if values is None:
        return None
    if isinstance(values, str | Mapping) or not isinstance(values, Iterable):
        return [cast("object", values)]
    return list(cast("Iterable[object]", values))


def swept_values(sweep: object) -> Mapping[str, Sequence[Any]] | None:
    """Return the swept values of each key."""
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
    return {key: several(values) or [] for key, values in swept.items()}


def chosen_seeds(seeds: object) -> list[int]:
    """Return the required seeds, or as many of them."""
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


def variants_of(problems: Sequence[AnyProblem], lists: Lists) -> list[Variant]:
    """Return every problem under every combination of the swept values, with checked settings."""
    for key, values in {"problems": problems, **vars(lists), **(lists.sweep or {})}.items():
        if key != "sweep" and values is not None and len(values) == 0:
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
            message = error.message if error.key is None else f"{error.key} {error.message}"
            raise InputError(message, remedy=error.remedy, **where) from error
        settings = [
            (each.sweep, *task_of(one).labels(one)) for each in found for one in each.settings
        ]
        if any(setting in settings[:n] for n, setting in enumerate(settings)):
            raise InputError("has a setting that is there twice", remedy="leave it out", **where)
    return found


def _product(problems: Sequence[AnyProblem], lists: Lists) -> list[Variant]:
    """Return the product of all lists."""
    swept = dict(lists.sweep or {})
    for key, option in OWN_OPTIONS.items():
        if key in swept and getattr(lists, option) is not None:
            raise InputError(f"is swept, and given as {option}", key=key, remedy="give it once")
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
    """Return a problem with each combination of cost-to-go, planner and horizon, once each."""
    task = task_of(problem)
    if task.simulate is None:
        raise InputError(
            f"{problem.name} asks for {problem.task}, which has no runs to compare",
            file=problem.file,
            key="problem.task",
            remedy="compare problems that can be simulated",
        )
    found: dict[tuple[object, ...], AnyProblem] = {}
    for cost, planner, horizon in product(
        costs, lists.planners or (None,), lists.horizons or (None,)
    ):
        one = task.overridden(problem, horizon=horizon, planner=planner, cost_to_go=cost)
        own_horizon, *others = task.labels(one)
        # Planners that foresee the whole run plan alike with every horizon.
        found.setdefault((own_horizon if task.has_horizon(one) else None, *others), one)
    return tuple(found.values())
