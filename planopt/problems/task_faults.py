"""What a task asks of the tables of a problem file: several of them at once, no geometry."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from planopt.objectives.terms.term import registered_terms
from planopt.problems.planner_kinds import names_with, planner_kind
from planopt.problems.rule_kinds import rule_kind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from planopt.objectives.terms.term import Term
    from planopt.problems.schema import ProblemFile
    from planopt.problems.schema_moving import MovingTable
    from planopt.problems.schema_robot import RobotTable

MOST_TURN_RAD = 2.0 * math.pi
"""What a robot may turn in a step: more than a circle of the same input is nothing to plan."""


def task_fault(tables: ProblemFile) -> str | None:
    """What keeps tables from being a problem of its task, in words; None if nothing does."""
    fault = _reach_fault(tables) if tables.problem.task == "reach" else _terms_fault(tables)
    return fault or _same_name("world.moving", tables.world.moving)


def _reach_fault(tables: ProblemFile) -> str | None:
    """What keeps tables from being a problem that is to reach a goal."""
    for number, robot in enumerate(tables.robots):
        if robot.goal_m is None:
            return f"task reach needs robots[{number}].goal_m"
        if robot.weights is not None:
            return f"task reach has no terms, and no robots[{number}].weights of any"
    if tables.objective.terms:
        return "task reach has no objective.terms"
    if tables.targets:
        return "task reach has no targets"
    rule = rule_kind(tables.constraints.connectivity)
    if tables.constraints.p_min == 0.0 and not rule.asks_without_p_min:
        return "task reach needs constraints.p_min above 0"
    if not planner_kind(tables.planner.name).reaches_goals:
        return (
            f"planner.name {tables.planner.name} is not for task reach: use "
            f"{names_with('reaches_goals')}"
        )
    return _same_name("robots", tables.robots) or _dynamics_fault(tables)


def _terms_fault(tables: ProblemFile) -> str | None:
    """What keeps tables from being a problem whose objective is a sum of terms."""
    task, terms = tables.problem.task, tables.objective.terms
    if not terms or terms[0].task != task:
        kinds = [each.kind for each in registered_terms() if each.task == task]
        return f"task {task} needs objective.terms that begin with one of kind {' or '.join(kinds)}"
    leads = any(term.steers == "goal" for term in terms)
    for number, robot in enumerate(tables.robots):
        fault = _fault_of_robot(terms, robot, number)
        if fault is not None:
            return fault
        if not leads and robot.goal_m is not None:
            return f"task {task} has no robots.goal_m without a term of kind goal"
    for key in ("effort_weight_s2_m2", "cost_to_go", "outage_price", "outage_charge"):
        if key in tables.objective.model_fields_set:
            return f"objective.{key} is for task reach, not for {task}"
    if not leads and "goal_radius_m" in tables.constraints.model_fields_set:
        return f"constraints.goal_radius_m is for task reach and terms of kind goal, not for {task}"
    tracked = any(term.sensor is not None for term in terms)
    if tracked != bool(tables.targets):
        return "a term of kind tracking and an entry of targets go together"
    return _same_name("robots", tables.robots) or _dynamics_fault(tables)


def _fault_of_robot(terms: Sequence[Term], robot: RobotTable, number: int) -> str | None:
    """What keeps the terms that count for one robot from being planned for."""
    key, weights = f"robots[{number}]", robot.weights
    if weights is not None and len(weights) != len(terms):
        return f"{key}.weights has {len(weights)} numbers for {len(terms)} objective.terms"
    own = [t for t, w in zip(terms, weights, strict=True) if w > 0.0] if weights else list(terms)
    if not own:
        return f"{key}.weights are all 0: a robot needs a term of its own"
    if any(term.steers == "goal" for term in own) and robot.goal_m is None:
        return f"a term of kind goal needs {key}.goal_m"
    if weights and robot.goal_m is not None and not any(term.steers == "goal" for term in own):
        return f"{key}.goal_m needs a weight above 0 of the term of kind goal"
    if sum(term.steers is not None for term in own) > 1:
        return (
            f"two of objective.terms steer {key}: only one may have the form two_layer or one of "
            "the kinds until_connected and goal, or a weight above 0 in its weights"
        )
    return None


def _dynamics_fault(tables: ProblemFile) -> str | None:
    """What keeps robots that cannot turn or stop at will from being planned for."""
    for number, robot in enumerate(tables.robots):
        if robot.dynamics == "single_integrator":
            continue
        if not planner_kind(tables.planner.name).has_dynamics:
            return (
                f"planner.name {tables.planner.name} is for robots of dynamics single_integrator, "
                f"robots[{number}] has {robot.dynamics}: use {names_with('has_dynamics')}"
            )
        turn_rad = (robot.turn_rate_max_rad_s or 0.0) * tables.planner.step_s
        if turn_rad > MOST_TURN_RAD:
            return (
                f"robots[{number}].turn_rate_max_rad_s lets it turn by {turn_rad:.3g} rad in a "
                f"step, which should be at most a full circle: lessen it or planner.step_s"
            )
    return None


def _same_name(table: str, entries: Sequence[RobotTable] | Sequence[MovingTable]) -> str | None:
    """What keeps the entries of a table from being told apart."""
    names = [entry.name for entry in entries]
    for number, name in enumerate(names):
        if names.index(name) < number:
            return (
                f"{table}[{number}].name is that of {table}[{names.index(name)}] too: "
                "give each a name of its own"
            )
    return None
