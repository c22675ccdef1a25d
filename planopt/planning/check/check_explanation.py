"""Judge what a saved plan says would help: it must fit the problem, and the limits found again.

Whether the problem solved again was verified (`verified`) only planning again could tell; it is
taken as it stands.
"""

from __future__ import annotations

from collections.abc import Sequence

from planopt.planning.check.agreement import EXACT, PREDICTION
from planopt.planning.explain.case import Case
from planopt.planning.explain.explanation import Relaxation
from planopt.planning.explain.fault import Fault, faults_of
from planopt.planning.explain.keys import Key, blamed_keys, connection_keys, moving_keys, other_keys
from planopt.planning.explain.possible import is_possible
from planopt.planning.free_space import is_joined
from planopt.planning.plan import Verdict
from planopt.planning.robot_problem import problem_of_robot
from planopt.problems.problem import Problem

OBSTACLE = "world.obstacles ("


def explanation_faults(case: Case, explanation: Sequence[Relaxation]) -> list[str]:
    """What in the explanation of one robot's plan cannot be so.

    Parameters
    ----------
    case
        The plan as it was judged again.
    explanation
        Every change that is said to help this robot.
    """
    if case.plan.verdict is Verdict.VERIFIED:
        return ["explanation: says what would help, but the plan is verified"] * bool(explanation)
    missed = faults_of(case)
    faults: list[str] = []
    for one in explanation:
        name = one.constraint
        if one.robot != case.problem.robots[case.number].name:
            faults.append(f"explanation: {name} is said of {one.robot}, whose plan this is not")
        about = [(fault, key) for fault in missed for key in _keys(case, fault) if key.name == name]
        if not about:
            faults.append(f"explanation: {name} does not concern a plan that there is")
            continue
        fitting = [fault for fault, _ in about if one.stages == fault.stages]
        if not fitting:
            faults.append(f"explanation: stages of {name} are not those that miss what is asked")
        fault = (fitting or [about[0][0]])[0]
        if one.shortfall_unit != fault.unit or not _near(one.shortfall, fault.shortfall):
            short = f"{fault.shortfall:.6g} {fault.unit}".rstrip()
            faults.append(f"explanation: the shortfall of {name} is {short}")
        faults += _value_faults(case, fault, about[0][1], one)
    return faults


def _value_faults(case: Case, fault: Fault, key: Key, one: Relaxation) -> list[str]:
    """What is wrong with the values of an entry."""
    if key.asked == key.limit:
        stands = one.value is None and one.relaxed_value is None and not one.unit
        return [] if stands else [f"explanation: {key.name} has no value"]
    asked = f"{key.asked:g} {key.unit}".rstrip()
    if one.value != key.asked or one.unit != key.unit:
        return [f"explanation: {key.name} is {asked}"]
    if one.relaxed_value is None or not 0.0 < key.amount_of(one.relaxed_value) <= key.most:
        return [f"explanation: {key.name} has no value that is looser than {asked}"]
    changed = problem_of_robot(key.changed(case.problem, one.relaxed_value), case.number)
    if one.verified and fault.missed == "connection" and not is_possible(changed, case.posteriors):
        return [f"explanation: {key.name} {one.relaxed_value:g} does not help"]
    return []


def _keys(case: Case, fault: Fault) -> list[Key]:
    """Every key that a fault may be explained by."""
    return [*blamed_keys(case, fault), *other_keys(case, fault), *moving_keys(case, fault)]


def no_way_faults(problem: Problem, explanation: Sequence[Relaxation]) -> list[str]:
    """The same where no way leads to the goal."""
    faults: list[str] = []
    asked, whole = problem.constraints.clearance_m, problem
    names = [robot.name for robot in whole.robots]
    for one in explanation:
        key, relaxed = one.constraint, one.relaxed_value
        if one.robot not in names:
            faults.append(f"explanation: {key} does not fit the problem")
            continue
        problem = problem_of_robot(whole, names.index(one.robot))
        if key == "constraints.clearance_m" and relaxed is not None:
            helps = 0.0 <= relaxed < asked and is_joined(problem, relaxed)
            fits = one.value == asked and _near(one.shortfall, asked - relaxed, EXACT)
        elif key == "planner.step_s" and relaxed is not None:
            helps = 0.0 < relaxed < problem.planner.step_s and is_joined(problem, asked)
            fits = one.value == problem.planner.step_s and _near(
                one.shortfall, problem.planner.step_s - relaxed, EXACT
            )
        elif any(key == each.name for each in connection_keys(problem)):
            [loosened] = [each for each in connection_keys(problem) if key == each.name]
            # What is believed is not saved with no plan: only planning again could tell more.
            helps = problem.constraints.rule.slack_max_db is not None and (
                relaxed is None or 0.0 < loosened.amount_of(relaxed) <= loosened.most
            )
            fits = one.value == loosened.asked and one.shortfall is None
        else:
            named = [o for o in problem.workspace.obstacles if key == f"{OBSTACLE}{o.name})"]
            helps = any(is_joined(problem, asked, without=obstacle) for obstacle in named)
            fits = one.value is None and relaxed is None and one.shortfall is None
        if not helps:
            faults.append(f"explanation: {key} does not open a way to the goal")
        if not fits or one.stages:
            faults.append(f"explanation: {key} does not fit the problem")
    return faults


def _near(said: float | None, found: float, within: float = PREDICTION) -> bool:
    return said is not None and abs(said - found) <= within
