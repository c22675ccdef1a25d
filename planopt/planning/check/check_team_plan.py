"""Judge saved plans of several robots, made from one belief."""

from __future__ import annotations

from dataclasses import replace

from planopt.planning.certificate import Certificate
from planopt.planning.check.agreement import disagreements, in_words
from planopt.planning.check.check_belief import NOTHING_TAKEN, belief_reasons
from planopt.planning.check.check_explanation import explanation_faults
from planopt.planning.check.check_plan import effort_faults
from planopt.planning.check.check_steps import steps_reasons
from planopt.planning.check.provenance import provenance_faults
from planopt.planning.check.rebuilt import Effort, rebuilt_plan
from planopt.planning.check.worth_again import worth_again
from planopt.planning.explain.case import Case
from planopt.planning.files.aim_json import aim_again
from planopt.planning.files.belief_file import first_posteriors, last_posteriors
from planopt.planning.files.explanation_json import explanation_again
from planopt.planning.files.read_drive import drive_of
from planopt.planning.files.read_team import SavedTeam
from planopt.planning.files.saved import PLAN_FILE
from planopt.planning.files.steps_file import STEPS_FILE, joined_steps, steps_of_plan
from planopt.planning.files.team_solution_json import TeamPlanRecord, team_plan_json
from planopt.planning.given import Given
from planopt.planning.ground_reasons import obstacles_met
from planopt.planning.loop.target_watch import aim_of, watch_target
from planopt.planning.plan import Plan
from planopt.planning.proof.circumstances import circumstances_of
from planopt.planning.proof.verify import judge
from planopt.planning.robot_problem import problem_of_robot
from planopt.planning.team.reservations import beside, others_of
from planopt.planning.team.team_certificate import worst_of_robots
from planopt.planning.team.team_seeds import team_seeds
from planopt.planning.worth.aim import Aim
from planopt.planning.worth.region import workspace_region
from planopt.robots.braked_motion import braked_motion
from planopt.world.clearance import index_obstacles


def check_team_plan(
    saved: SavedTeam, record: TeamPlanRecord, given: Given | None
) -> tuple[list[Certificate], list[str]]:
    """The worst of the plans' certificates, and every reason to reject.

    Parameters
    ----------
    saved, record
        What was read.
    given
        What problem and seed give, if it is to be had.
    """
    problem, belief = saved.problem, saved.beliefs[0]
    horizon = problem.planner.horizon
    for robot, steps in zip(problem.robots, saved.steps, strict=True):
        if len(steps.steps) != horizon + 1:
            return [], [
                f"{STEPS_FILE}: {len(steps.steps) - 1} steps of {robot.name} are planned, "
                f"planner.horizon is {horizon}"
            ]
    index, region = index_obstacles(problem.workspace), workspace_region(problem)
    posteriors = last_posteriors(belief, first_posteriors(belief))
    posterior, alone = posteriors[0], circumstances_of(problem, posteriors)
    watch = watch_target(problem, team_seeds(problem, record.seed).target)
    explanation = explanation_again(record.explanation)
    names = {robot.name for robot in problem.robots}
    reasons = [
        f"{PLAN_FILE}, key explanation: there is no robot {one.robot}"
        for one in explanation
        if one.robot not in names
    ]
    drives = [
        drive_of(
            robot.dynamics,
            steps.positions_m,
            steps.motion,
            saved.file.parent / STEPS_FILE,
            f"robot {robot.name}",
        )
        for robot, steps in zip(problem.robots, saved.steps, strict=True)
    ]
    motions = [
        braked_motion(steps.positions_m, drive, problem.planner.step_s)
        for steps, drive in zip(saved.steps, drives, strict=True)
    ]
    plans: list[Plan] = []
    aims: list[Aim] = []
    for number, (robot, steps) in enumerate(zip(record.robots, saved.steps, strict=True)):
        own, path = problem_of_robot(problem, number), steps.positions_m
        one = own.robots[0]
        drive = drives[number]
        circumstances = replace(alone, moving=beside(problem, 0, others_of(motions, number)))
        residual = robot.certificate.kkt_residual
        judgement = judge(
            own, index, posterior, one.start_state, path, residual, circumstances, drive
        )
        aim = aim_again(robot.aim, aim_of(watch, number, horizon))
        effort = Effort(robot.wall_s, robot.solve_s, robot.iterations)
        worth = worth_again(own, posterior, path, aim, region, circumstances, index)
        plan = rebuilt_plan(own, path, judgement, robot, effort, worth, drive=drive)
        where = f"robots[{number}]."
        if drive is None:
            reasons += [f"{plan.robot}: {text}" for text in obstacles_met(own, index, path)]
        reasons += [f"{plan.robot}: {text}" for text in plan.certificate.reasons]
        reasons += [
            f"{PLAN_FILE}, key {where}{key}: {fault}"
            for key, fault in provenance_faults(own, plan, None)
        ]
        reasons += effort_faults(plan, where)
        case = Case(problem, number, posteriors, plan, circumstances.moving)
        own_explanation = [one for one in explanation if one.robot == plan.robot]
        reasons += [
            f"{PLAN_FILE}, key {fault}" for fault in explanation_faults(case, own_explanation)
        ]
        plans.append(plan)
        aims.append(aim)
    found = {
        **team_plan_json(problem, record.seed, plans, aims, explanation),
        # What was asked is not judged: library_remarks says what there is to say.
        "problem_file": saved.data["problem_file"],
    }
    reasons += in_words(PLAN_FILE, disagreements(saved.data, found))
    again = joined_steps([steps_of_plan(plan) for plan in plans])
    reasons += steps_reasons(joined_steps(saved.steps), again)
    reasons += belief_reasons(problem, belief, posteriors, given, NOTHING_TAKEN, record.seed)
    return [worst_of_robots({plan.robot: plan.certificate for plan in plans})], reasons
