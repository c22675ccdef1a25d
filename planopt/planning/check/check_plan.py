"""Judge a saved plan: the verifier decides, and every field must follow from it and the files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.nearest.place_tree import PlaceTree
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.certificate import Certificate
from planopt.planning.check.agreement import EXACT, disagreements, in_words
from planopt.planning.check.check_belief import NOTHING_TAKEN, belief_reasons
from planopt.planning.check.check_explanation import explanation_faults
from planopt.planning.check.check_steps import steps_reasons
from planopt.planning.check.provenance import UNSOLVED, provenance_faults
from planopt.planning.check.rebuilt import Effort, rebuilt_reach_plan
from planopt.planning.explain.case import Case
from planopt.planning.files.belief_file import SavedBelief, first_posteriors, last_posteriors
from planopt.planning.files.explanation_json import explanation_again
from planopt.planning.files.read_drive import drive_of
from planopt.planning.files.saved import PLAN_FILE
from planopt.planning.files.solution_json import PlanRecord, plan_json
from planopt.planning.files.steps_file import STEPS_FILE, Steps, steps_of_plan
from planopt.planning.given import Given
from planopt.planning.ground_reasons import obstacles_met
from planopt.planning.holes import holes_on
from planopt.planning.plan import Plan, Termination
from planopt.planning.proof.circumstances import Circumstances, circumstances_of
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.proof.verify import judge
from planopt.planning.roads import build_roads
from planopt.problems.problem import Problem
from planopt.world.clearance import index_obstacles


def check_plan(
    problem: Problem,
    data: Mapping[str, Any],
    record: PlanRecord,
    steps: Steps,
    belief: SavedBelief,
    given: Given | None,
    folder: Path,
) -> tuple[list[Certificate], list[str]]:
    """The plan's certificate, computed again, and every reason to reject.

    Parameters
    ----------
    problem, data, record
        From ``plan.json``: its problem, all of it, and what is taken from it.
    steps, belief
        The files beside it.
    given
        What problem and seed give, if it is to be had.
    folder
        Where they are, for messages.

    Raises
    ------
    InputError
        States or inputs of a robot that has some are missing.
    """
    path = steps.positions_m
    if len(path) != problem.planner.horizon + 1:
        return [], [
            f"{STEPS_FILE}: {len(path) - 1} steps are planned, planner.horizon is "
            f"{problem.planner.horizon}"
        ]
    index = index_obstacles(problem.workspace)
    posteriors = last_posteriors(belief, first_posteriors(belief))
    robot = problem.robots[0]
    table = folder / STEPS_FILE
    drive = drive_of(robot.dynamics, path, steps.motion, table, f"robot {robot.name}")
    circumstances = circumstances_of(problem, posteriors)
    residual = record.certificate.kkt_residual
    judgement = judge(
        problem, index, posteriors[0], robot.start_state, path, residual, circumstances, drive
    )
    plan = rebuilt_reach_plan(
        problem,
        path,
        judgement,
        record,
        Effort(record.wall_s, record.solve_s, record.iterations),
        drive,
    )
    plan = replace(plan, **_on_the_way(problem, record, plan, posteriors, circumstances))
    explanation = explanation_again(record.explanation)
    case = Case(problem, 0, posteriors, plan, circumstances.moving)
    found = {
        **plan_json(problem, record.seed, plan, explanation),
        # What was asked is not judged: library_remarks says what there is to say.
        "problem_file": data["problem_file"],
    }
    reasons = obstacles_met(problem, index, path) if drive is None else []
    reasons += judgement.certificate.reasons
    reasons += in_words(PLAN_FILE, disagreements(data, found))
    reasons += [
        f"{PLAN_FILE}, key {key}: {fault}" for key, fault in provenance_faults(problem, plan, None)
    ]
    reasons += effort_faults(plan, "")
    reasons += [f"{PLAN_FILE}, key {fault}" for fault in explanation_faults(case, explanation)]
    reasons += steps_reasons(steps, steps_of_plan(plan))
    reasons += belief_reasons(problem, belief, posteriors, given, NOTHING_TAKEN, record.seed)
    return [judgement.certificate], reasons


def _on_the_way(
    problem: Problem,
    record: PlanRecord,
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
    """Whether a route (r, 2) is one over the lattice to the goal."""
    roads = build_roads(problem, np.asarray(problem.goal_m))
    nearest, away = PlaceTree(roads.nodes_m).nearest(route_m, 1)
    nodes = nearest[:, 0]
    joined = (roads.sources[nodes[1:]] == nodes[:-1, None]).any(axis=1)
    at_goal = float(np.linalg.norm(route_m[-1] - np.asarray(problem.goal_m)))
    return bool(away.max() <= EXACT and joined.all() and at_goal <= EXACT)


def effort_faults(plan: Plan, where: str) -> list[str]:
    """Wall times cannot be computed again, but solving is part of planning and takes time.

    Parameters
    ----------
    plan
        The plan.
    where
        What to put before the key.
    """
    text = f"{PLAN_FILE}, key {where}solve_s: {plan.solve_s:g}"
    if plan.solve_s > plan.wall_s:
        return [f"{text}, but wall_s is {plan.wall_s:g}"]
    # A budget may be spent before anything is solved.
    unsolved = (*UNSOLVED, Termination.TIME_LIMIT)
    if plan.solve_s == 0.0 and plan.termination not in unsolved:
        return [f"{text}, but the termination is {plan.termination.value}"]
    return []
