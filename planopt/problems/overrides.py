"""Change single settings of a problem, as the command line and the studies do."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, cast

from planopt.errors import InputError
from planopt.parts import part_of
from planopt.problems.load import check_files, saved_table
from planopt.problems.objective import ReachObjective
from planopt.problems.planner_kinds import names_with, planner_kind
from planopt.problems.problem import Problem, check_problem, tables_of
from planopt.problems.tasks import TaskProblem, problem_from

AnyProblem = TypeVar("AnyProblem", bound=Problem | TaskProblem)

_PART = re.compile(r"(\w+)((?:\[(?:\d+|\*)\])*)")
"""A part of a dotted key: a name, and which entries of a list, if it names one."""


def with_overrides(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
) -> Problem:
    """`problem` with the given settings in place of its own, checked; None keeps them.

    The whole problem is checked, since :func:`dataclasses.replace` does not check one.
    """
    require_motion(problem)
    given = {
        name: value
        for name, value in (
            ("horizon", horizon),
            ("planner", planner),
            ("cost to go", cost_to_go),
        )
        if value is not None
    }
    try:
        changed = _overridden(problem, horizon, planner, cost_to_go)
        check_problem(changed)
    except InputError as error:
        if not given:
            raise
        check_problem(problem)
        settings = ", ".join(f"{name} {value}" for name, value in given.items())
        raise InputError(
            f"{error.message}; {settings} was given in place of the problem's own",
            key=error.key,
            remedy=error.remedy,
        ) from None
    return changed


def require_motion(problem: Problem) -> None:
    """Raise an error for what is no problem of motion planning, whatever its type says."""
    part_of("problem", problem, Problem, "load or make a Problem")


def _overridden(
    problem: Problem, horizon: int | None, planner: str | None, cost_to_go: str | None
) -> Problem:
    """Return `problem` with other settings, each validated by itself."""
    changes = {"horizon": horizon, "name": planner}
    changes = {name: value for name, value in changes.items() if value is not None}
    # The changed part validates itself.
    settings = replace(problem.planner, **changes) if changes else problem.planner
    is_reach = isinstance(problem.objective, ReachObjective)
    if is_reach and not planner_kind(settings.name).reaches_goals:
        raise InputError(
            f"is {settings.name}, which has no way to a goal",
            key="planner.name",
            remedy=f"use {names_with('reaches_goals')} for the task reach",
        )
    changed = replace(problem, planner=settings) if changes else problem
    if cost_to_go is None:
        return changed
    if not is_reach:
        raise InputError(
            f"is for problems that are to reach a goal, {problem.name} is to {problem.task}",
            key="objective.cost_to_go",
            remedy="leave it out",
        )
    return replace(changed, objective=replace(problem.objective, cost_to_go=cost_to_go))


def with_changes(problem: AnyProblem, changes: Mapping[str, object]) -> AnyProblem:
    """`problem` with other values for any keys of its problem file, checked."""
    if not changes:
        return problem
    given = ", ".join(f"{key} = {value}" for key, value in changes.items())
    tables = problem.tables() if isinstance(problem, TaskProblem) else tables_of(problem)
    if not isinstance(problem, TaskProblem):
        # Only the tables that change are validated again.
        for branch in {re.split(r"[.\[]", key)[0] for key in changes} & tables.keys():
            tables[branch] = saved_table(tables[branch])
    for key, value in changes.items():
        for table, name in _places(tables, key):
            table[name] = value
    try:
        changed = problem_from(tables, folder=Path.cwd(), file=None)
        if isinstance(problem, TaskProblem):
            return changed
        check_files(changed)
        return cast("AnyProblem", replace(changed, file=problem.file))
    except InputError as error:
        raise InputError(
            f"{error.message}; {given} was given in place of the problem's own",
            key=error.key,
            remedy=error.remedy,
        ) from None


def _places(tables: dict[str, Any], key: str) -> list[tuple[Any, str | int]]:
    """Return the tables that have a value for a dotted key, with its last part."""
    found: list[tuple[Any, str | int]] = [({"": tables}, "")]
    for part in key.split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise InputError("is no key", key=key, remedy="use one such as robots[0].speed_max_m_s")
        found = [(_entered(table, name, key), match[1]) for table, name in found]
        for index in re.findall(r"\[(\d+|\*)\]", match[2]):
            entered = [_entries(table, name, key) for table, name in found]
            found = [
                (entries, number)
                for entries in entered
                for number in (range(len(entries)) if index == "*" else (int(index),))
            ]
            if index != "*" and any(int(index) >= len(entries) for entries in entered):
                raise InputError(
                    f"has {len(entered[0])} entries, counted from 0",
                    key=key,
                    remedy=f"give an index up to {len(entered[0]) - 1}, or [*] for all",
                )
    return found


def _entered(table: Any, name: str | int, key: str) -> dict[str, Any]:
    """The table that a table or list has under a name; one that is not there is made."""
    value: Any = table.setdefault(name, {}) if isinstance(name, str) else table[name]
    if isinstance(value, list):
        raise InputError(
            f"{name} is a list", key=key, remedy=f"say of which: {name}[0], or {name}[*] for all"
        )
    if not isinstance(value, dict):
        raise InputError(f"{name} is no table", key=key, remedy="name a key of a table")
    return cast("dict[str, Any]", value)


def _entries(table: Any, name: str | int, key: str) -> list[Any]:
    """The list that a table or list has under a name."""
    value: Any = table.get(name) if isinstance(name, str) else table[name]
    if not isinstance(value, list):
        raise InputError(f"{name} is no list", key=key, remedy=f"leave out the index of {name}")
    return cast("list[Any]", value)
