"""Judge saved plans: the verifier decides, and every field must follow from it and the files.

That includes the explanation of a plan that is not verified. Only planning again could tell whether
the changed problem of an explanation was verified (`verified`); it is taken as it stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.nearest.place_tree import PlaceTree
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.certificate import Certificate
from planopt.planning.check.agreement import EXACT, PREDICTION, disagreements, in_words
from planopt.planning.check.check_belief import (
    NOTHING_TAKEN,
    belief_again,
    belief_reasons,
    learnt_again,
)
from planopt.planning.check.check_steps import steps_reasons
from planopt.planning.check.rebuilt import (
    UNSOLVED,
    Asked,
    Effort,
    Place,
    provenance_faults,
    rebuilt_plan,
)
from planopt.planning.explain.explanation import Case, Crossing, Relaxation
from planopt.planning.explain.faults import Fault, faults_of
from planopt.planning.explain.keys import Key, blamed_keys, connection_keys, moving_keys
from planopt.planning.files.belief_file import first_posteriors, last_posteriors
from planopt.planning.files.drive_table import drive_of
from planopt.planning.files.read_saved import Saved
from planopt.planning.files.saved import FORMAT, PLAN_FILE
from planopt.planning.files.solution_json import (
    PlanRecord,
    RobotPlanRecord,
    aim_again,
    explanation_again,
    solution_json,
)
from planopt.planning.files.steps_file import STEPS_FILE, joined_steps, steps_of_plan
from planopt.planning.free_space import is_joined, obstacles_met
from planopt.planning.given import Given, team_seeds
from planopt.planning.holes import holes_on
from planopt.planning.loop.target_watch import aim_of, watch_target
from planopt.planning.plan import Plan, Termination, Verdict
from planopt.planning.proof.circumstances import Circumstances, circumstances_of
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.roads import build_roads
from planopt.planning.solution import Solution
from planopt.planning.team.reservations import beside, others_of, worst_of_robots
from planopt.planning.worth.situation import Aim, counts_others
from planopt.problems.problem import Problem, problem_of_robot
from planopt.robots.drive import braked_motion

OBSTACLE = "world.obstacles ("


def explanation_faults(case: Case, explanation: Sequence[Relaxation]) -> list[str]:
    """Return what in the explanation of one robot's plan cannot be so."""
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
        faults += _value_faults(about[0][1], one)
    return faults


def _value_faults(key: Key, one: Relaxation) -> list[str]:
    """Return what is wrong with the values of an entry."""
    if key.asked == key.limit:
        stands = one.value is None and one.relaxed_value is None and not one.unit
        return [] if stands else [f"explanation: {key.name} has no value"]
    asked = f"{key.asked:g} {key.unit}".rstrip()
    if one.value != key.asked or one.unit != key.unit:
        return [f"explanation: {key.name} is {asked}"]
    if one.relaxed_value is None or not 0.0 < key.amount_of(one.relaxed_value) <= key.most:
        return [f"explanation: {key.name} has no value that is looser than {asked}"]
    return []


def _keys(case: Case, fault: Fault) -> list[Key]:
    """Every key that a fault may be explained by."""
    return [*blamed_keys(case.problem, fault), *moving_keys(case.problem, fault)]


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


LATER_KEY = "crossings"
"""Key that plans of format 2 did not have at first; for one version it may be missing."""


def check_plan(
    saved: Saved, record: PlanRecord, given: Given | None
) -> tuple[list[Certificate], list[str]]:
    """Return the worst of the plans' certificates, computed again, and every reason to reject."""
    problem, belief = saved.problem, saved.beliefs[0]
    learnt, unfitted = learnt_again(problem, saved.beliefs)
    if faults := length_faults(saved) or unfitted:
        return [], faults
    solution, reasons = rebuilt_solution(saved, record, learnt[0])
    found = {
        "format": FORMAT,
        **solution_json(solution),
        # What was asked is not judged: library_remarks says what there is to say.
        "problem_file": saved.data["problem_file"],
    }
    if LATER_KEY not in saved.data:
        found.pop(LATER_KEY)
    reasons += in_words(PLAN_FILE, disagreements(saved.data, found))
    again = joined_steps([steps_of_plan(plan) for plan in solution.plans])
    reasons += steps_reasons(joined_steps(saved.steps), again)
    reasons += belief_reasons(
        problem,
        belief,
        learnt[0],
        solution.belief.posteriors,
        given,
        NOTHING_TAKEN,
        record.seed,
    )
    return [worst_of_robots({plan.robot: plan.certificate for plan in solution.plans})], reasons


def length_faults(saved: Saved) -> list[str]:
    """Return what is wrong with the lengths of plans: they have those that the problem asks."""
    horizon = saved.problem.planner.horizon
    return [
        f"{STEPS_FILE}: {len(steps.steps) - 1} steps of {robot.name} are planned, "
        f"planner.horizon is {horizon}"
        for robot, steps in zip(saved.problem.robots, saved.steps, strict=True)
        if len(steps.steps) != horizon + 1
    ]


def rebuilt_solution(
    saved: Saved, record: PlanRecord, learnt: Sequence[Belief]
) -> tuple[Solution, list[str]]:
    """Return the plans as they must be, and every reason to reject what they are said to be."""
    problem = saved.problem
    posteriors = last_posteriors(saved.beliefs[0], first_posteriors(saved.beliefs[0]))
    place, alone = Place.of(problem), circumstances_of(problem, posteriors)
    watch = watch_target(problem, team_seeds(problem, record.seed).target)
    explanation = explanation_again(record.explanation)
    names = {robot.name for robot in problem.robots}
    reasons = [
        f"{PLAN_FILE}, key explanation: there is no robot {one.robot}"
        for one in explanation
        if one.robot not in names
    ]
    table = saved.file.parent / STEPS_FILE
    drives = [
        drive_of(robot.dynamics, steps.positions_m, steps.motion, table, f"robot {robot.name}")
        for robot, steps in zip(problem.robots, saved.steps, strict=True)
    ]
    motions = [
        braked_motion(steps.positions_m, drive, problem.planner.step_s)
        for steps, drive in zip(saved.steps, drives, strict=True)
    ]
    plans: list[Plan] = []
    aims = [
        aim_again(robot.aim, aim_of(watch, number, problem.planner.horizon))
        for number, robot in enumerate(record.robots)
    ]
    for number, (robot, steps) in enumerate(zip(record.robots, saved.steps, strict=True)):
        own, path, drive = problem_of_robot(problem, number), steps.positions_m, drives[number]
        moving = beside(problem, 0, others_of(motions, number))
        under = replace(alone, moving=moving)
        asked = Asked(own, place, posteriors, own.robots[0].start_state, aims[number], under)
        effort = Effort(robot.wall_s, robot.solve_s, robot.iterations)
        plan = rebuilt_plan(asked, path, drive, robot, robot.certificate.kkt_residual, effort)
        if problem.task == "reach":
            plan = replace(plan, **_on_the_way(own, robot, plan, posteriors, under))
        where = f"robots[{number}]."
        objections = obstacles_met(own, place.index, path) if drive is None else []
        objections += plan.certificate.reasons
        reasons += of_robot(problem, plan.robot, objections)
        reasons += [
            f"{PLAN_FILE}, key {where}{key}: {fault}"
            for key, fault in provenance_faults(own, plan, None)
        ]
        reasons += _effort_faults(plan, where)
        paths = [steps.positions_m for steps in saved.steps]
        reasons += [
            f"{PLAN_FILE}, key {where}aim.{fault}"
            for fault in pending_faults(aims[number], paths, number, problem.planner.rounds)
        ]
        case = Case(problem, number, posteriors, plan, moving)
        own_explanation = [one for one in explanation if one.robot == plan.robot]
        reasons += [
            f"{PLAN_FILE}, key {fault}" for fault in explanation_faults(case, own_explanation)
        ]
        plans.append(plan)
    reasons += [f"{PLAN_FILE}, key robots: {fault}" for fault in order_faults(problem, aims)]
    belief = belief_again(learnt, posteriors)
    crossings, faults = _crossings_again(problem, record, plans)
    reasons += faults
    told = (*explanation, *crossings)
    return Solution(problem, record.seed, belief, tuple(plans), tuple(aims), told), reasons


def _crossings_again(
    problem: Problem, record: PlanRecord, plans: Sequence[Plan]
) -> tuple[list[Crossing], list[str]]:
    """Return what the file says of crossings, and what of it cannot be so.

    The ways beside the plan are the search's, which the verifier does without: their lengths and
    costs are taken as they stand.
    """
    verified = {plan.robot: plan for plan in plans if plan.verdict is Verdict.VERIFIED}
    found: list[Crossing] = []
    faults: list[str] = []
    for number, one in enumerate(record.crossings):
        where = f"{PLAN_FILE}, key crossings[{number}]"
        plan = verified.get(one.robot)
        if plan is None or not plan.holes or one.robot in {other.robot for other in found}:
            faults.append(f"{where}: no verified plan of {one.robot} crosses a hole, or once more")
            continue
        if one.outside_m > one.kept_m:
            faults.append(f"{where}.outside_m: is longer than the way, kept_m {one.kept_m:g}")
        price, p_min = problem.reach.outage_price, problem.constraints.p_min
        lengths = one.cost_m, price, one.kept_m, one.outside_m
        found.append(Crossing(one.robot, plan.holes, *lengths, p_min))
    return found, faults


def pending_faults(
    aim: Aim, paths_m: Sequence[NDArray[np.float64]], number: int, rounds: int
) -> list[str]:
    """Return what is wrong with the plans that a robot says it was told."""
    # Shapes: paths_m (N + 1, 2).
    if rounds > 1:
        return []
    others = [path[1:] for other, path in enumerate(paths_m) if other != number]
    return [
        f"pending_m[{index}] is not the plan of another robot in this step"
        for index, told in enumerate(aim.pending.planned_m)
        if not any(
            told.shape == path.shape and np.abs(told - path).max() <= EXACT for path in others
        )
    ]


def order_faults(problem: Problem, aims: Sequence[Aim]) -> list[str]:
    """Return what is wrong with how many plans each robot says it was told in one step.

    Robots plan in turn, whoever begins: one of them was told no plan, another one plan, and so on,
    those left out that do not count what the others measure.
    """
    told = [len(aim.pending.planned_m) for aim in aims]
    owns = [problem_of_robot(problem, number) for number in range(len(aims))]
    counted = [count for own, count in zip(owns, told, strict=True) if counts_others(own)]
    in_order = len(set(counted)) == len(counted) and all(count < len(told) for count in counted)
    if not counted or problem.planner.rounds > 1 or in_order:
        return []
    should = list(range(len(told)))
    return [f"robots were told {sorted(counted)} plans, should be {should} in some order"]


def of_robot(problem: Problem, robot: str, objections: Sequence[str]) -> list[str]:
    """Return objections with the name of the robot that they concern, if there are several."""
    return [f"{robot}: {text}" if len(problem.robots) > 1 else text for text in objections]


def _on_the_way(
    problem: Problem,
    record: RobotPlanRecord,
    plan: Plan,
    posteriors: Sequence[ChannelPosterior],
    under: Circumstances,
) -> dict[str, Any]:
    """The rest of the way as it is saved, if it leads to the goal, and the holes on it."""
    if len(record.route.x_m) != len(record.route.y_m):
        return {}
    route = np.stack([record.route.x_m, record.route.y_m], axis=1).reshape(-1, 2)
    if len(route) and not _leads_to_goal(problem, route):
        return {}
    places = np.vstack([plan.positions_m, route])
    power = search_prediction(posteriors[0], places, under.broad)
    return {"route_m": route, "holes": holes_on(problem, power, places)}


def _leads_to_goal(problem: Problem, route_m: NDArray[np.float64]) -> bool:
    """Return whether a route (r, 2) is one over the lattice to the goal."""
    roads = build_roads(problem, np.asarray(problem.goal_m))
    nearest, away = PlaceTree(roads.nodes_m).nearest(route_m, 1)
    nodes = nearest[:, 0]
    joined = (roads.sources[nodes[1:]] == nodes[:-1, None]).any(axis=1)
    at_goal = float(np.linalg.norm(route_m[-1] - np.asarray(problem.goal_m)))
    return bool(away.max() <= EXACT and joined.all() and at_goal <= EXACT)


def _effort_faults(plan: Plan, where: str) -> list[str]:
    """Wall times cannot be computed again, but solving is part of planning and takes time."""
    text = f"{PLAN_FILE}, key {where}solve_s: {plan.solve_s:g}"
    if plan.solve_s > plan.wall_s:
        return [f"{text}, but wall_s is {plan.wall_s:g}"]
    # A budget may be spent before anything is solved.
    unsolved = (*UNSOLVED, Termination.TIME_LIMIT)
    if plan.solve_s == 0.0 and plan.termination not in unsolved:
        return [f"{text}, but the termination is {plan.termination.value}"]
    return []
