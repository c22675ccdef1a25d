"""Judge a saved run: every released plan on what was believed at its time, and all that follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.planning.certificate import Certificate
from planopt.planning.check.agreement import EXACT, disagreements, in_words
from planopt.planning.check.check_belief import Taken, belief_reasons, taken_on_the_way
from planopt.planning.check.check_steps import steps_reasons
from planopt.planning.check.provenance import provenance_faults
from planopt.planning.check.rebuilt import Effort, rebuilt_reach_plan
from planopt.planning.files.belief_file import (
    SavedBelief,
    first_posteriors,
    last_posteriors,
    posteriors_at,
)
from planopt.planning.files.read_drive import drive_of
from planopt.planning.files.run_json import (
    RunRecord,
    StepTimesRecord,
    released_plans_json,
    run_json,
)
from planopt.planning.files.saved import RUN_FILE
from planopt.planning.files.steps_file import STEPS_FILE, Steps, steps_of_run
from planopt.planning.given import Given
from planopt.planning.ground_reasons import obstacles_met
from planopt.planning.history import history_of
from planopt.planning.loop.clairvoyant import COSTS, run_costs
from planopt.planning.loop.ending import ending
from planopt.planning.loop.metrics import metrics_of
from planopt.planning.loop.rule_metrics import rule_metrics
from planopt.planning.loop.run import Outcome, Run
from planopt.planning.loop.step_log import step_log
from planopt.planning.loop.true_serving import true_serving_dbm
from planopt.planning.plan import Plan
from planopt.planning.proof.circumstances import circumstances_of
from planopt.planning.proof.verify import judge
from planopt.planning.roads import build_roads
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex, index_obstacles


def check_run(
    problem: Problem,
    data: Mapping[str, Any],
    record: RunRecord,
    steps: Steps,
    belief: SavedBelief,
    given: Given | None,
    folder: Path,
) -> tuple[list[Certificate], list[str]]:
    """A certificate for each released plan, computed again, and every reason to reject.

    Parameters
    ----------
    problem, data, record
        From ``run.json``: its problem, all of it, and what is taken from it.
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
    index = index_obstacles(problem.workspace)
    track = steps.positions_m
    robot, table = problem.robots[0], folder / STEPS_FILE
    driven = drive_of(robot.dynamics, track, steps.motion, table, f"robot {robot.name}")
    states = track if driven is None else driven.states
    reasons = obstacles_met(problem, index, track) if driven is None else []
    if np.abs(states[0] - robot.start_state).max() > EXACT:
        reasons.append(f"{STEPS_FILE}: the run does not start at robots[0].start_m")
    truths = () if given is None else given.truths
    roads = build_roads(problem, np.asarray(problem.goal_m))
    true = true_serving_dbm(problem, truths, track) if truths else steps.numbers["true_db"]
    connected = true[1:] >= problem.stations[0].threshold_dbm
    plans: list[Plan] = []
    posteriors = first_posteriors(belief)
    for step, released in enumerate(record.plans, start=1):
        posteriors = posteriors_at(belief, posteriors, step)
        path = np.stack([released.x_m, released.y_m], axis=1)
        proofs = [plan.certificate for plan in plans]
        history = history_of(problem, track[:step], connected[: step - 1], proofs)
        circumstances = circumstances_of(problem, posteriors, history)
        place = f"plans[{step - 1}].drive"
        drive = drive_of(robot.dynamics, path, released.drive, folder / RUN_FILE, place)
        here, residual = states[step - 1], released.kkt_residual
        judgement = judge(problem, index, posteriors[0], here, path, residual, circumstances, drive)
        plan = rebuilt_reach_plan(problem, path, judgement, released, Effort(), drive)
        where = f"{RUN_FILE}, key plans[{step - 1}]"
        reasons += plan_reasons(problem, index, where, step, plan, plans[-1] if plans else None)
        ahead = path if drive is None else drive.states
        if np.abs(ahead[:2] - states[step - 1 : step + 1]).max() > EXACT:
            reasons.append(
                f"step {step} of {STEPS_FILE} is not the first step of its plan, {RUN_FILE}, key "
                f"plans[{step - 1}]"
            )
        plans.append(plan)
    posteriors = last_posteriors(belief, posteriors)
    log = step_log(problem, track, true, plans)
    taken = taken_on_the_way(problem, belief, track, true)
    outcome, reason, faults = _ended(problem, states, taken, plans)
    # Without a truth these can only be taken as they stand.
    said: Mapping[str, float] = data.get("metrics", {})
    said = {key: said[key] for key in COSTS if key in said}
    costs = run_costs(problem, roads, index, truths, track, outcome) if truths else said
    run = Run(
        robot=problem.robots[0].name,
        horizon=problem.planner.horizon,
        planner=problem.planner.name,
        cost_to_go=problem.cost_to_go,
        seed=record.seed,
        outcome=outcome,
        reason=reason,
        log=log,
        metrics=metrics_of(log, plans, outcome, taken.learnt),
        rule=rule_metrics(problem, [log]),
        drive=driven,
        costs=costs,
    )
    found = {
        **run_json(problem, run),
        "plans": released_plans_json(plans),
        "step_s": record.step_s.model_dump(),
        # What was asked is not judged: library_remarks says what there is to say.
        "problem_file": data["problem_file"],
    }
    reasons += faults
    reasons += in_words(RUN_FILE, disagreements(data, found))
    reasons += step_time_faults(record.step_s, len(plans))
    reasons += steps_reasons(steps, steps_of_run(run.robot, log, run.drive))
    reasons += belief_reasons(problem, belief, posteriors, given, taken, record.seed)
    return [plan.certificate for plan in plans], reasons


def plan_reasons(
    problem: Problem,
    index: ObstacleIndex,
    where: str,
    step: int,
    plan: Plan,
    previous: Plan | None,
) -> list[str]:
    """What is wrong with one released plan.

    Parameters
    ----------
    problem, index
        What was asked, and its obstacles.
    where
        File and key of the plan.
    step
        Of which step it is.
    plan, previous
        The plan, and the one before it.
    """
    objections = list(plan.certificate.reasons)
    if objections and plan.drive is None:
        objections[:0] = obstacles_met(problem, index, plan.positions_m)
    steps = len(plan.positions_m) - 1
    if steps != problem.planner.horizon:
        objections.append(f"has {steps} steps, planner.horizon is {problem.planner.horizon}")
    return [
        *(f"{where}, the plan for step {step}: {objection}" for objection in objections),
        *(f"{where}.{key}: {fault}" for key, fault in provenance_faults(problem, plan, previous)),
    ]


def _ended(
    problem: Problem, states: NDArray[np.float64], taken: Taken, plans: Sequence[Plan]
) -> tuple[Outcome, str, list[str]]:
    """How the run ended and why in words, and what is wrong with where it did."""
    learnt, track = taken.learnt, list(states)
    for step in range(len(plans)):
        led_here = plans[step - 1] if step else None
        ended = ending(problem, track[: step + 1], learnt[:step], led_here)
        if ended is not None:
            outcome, reason = ended
            return outcome, reason, [f"{STEPS_FILE}: the run goes on after step {step}, {reason}"]
    ended = ending(problem, track, learnt, plans[-1] if plans else None)
    if ended is None:
        return (
            Outcome.STEP_LIMIT,
            "",
            [
                f"{STEPS_FILE}: the run ends after step {len(plans)}, short of the goal, of a "
                f"standstill and of planner.max_steps {problem.planner.max_steps}"
            ],
        )
    return *ended, []


def step_time_faults(times: StepTimesRecord, steps: int) -> list[str]:
    """Quantiles of wall times cannot be computed again, but they have an order."""
    given = [value for value in (times.p50, times.p95, times.max) if value is not None]
    if len(given) != (3 if steps else 0):
        return [f"{RUN_FILE}, key step_s: {len(given)} values for {steps} steps"]
    if given == sorted(given):
        return []
    return [
        f"{RUN_FILE}, key step_s: p50 {times.p50:g}, p95 {times.p95:g} and max {times.max:g} are "
        "out of order"
    ]
