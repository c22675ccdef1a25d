"""Judge a saved run of several robots: every plan on what its robot knew, and all that follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.mapping import Region
from planopt.planning.certificate import Certificate
from planopt.planning.check.agreement import EXACT, disagreements, in_words
from planopt.planning.check.check_belief import belief_reasons, taken_on_the_way
from planopt.planning.check.check_run import plan_reasons, step_time_faults
from planopt.planning.check.check_steps import steps_reasons
from planopt.planning.check.rebuilt import Effort, rebuilt_plan
from planopt.planning.check.worth_again import worth_again
from planopt.planning.files.aim_json import aim_again
from planopt.planning.files.belief_file import (
    first_posteriors,
    last_posteriors,
    posteriors_at,
)
from planopt.planning.files.read_drive import drive_of
from planopt.planning.files.read_team import SavedTeam
from planopt.planning.files.saved import RUN_FILE
from planopt.planning.files.steps_file import STEPS_FILE, joined_steps, steps_of_run
from planopt.planning.files.team_run_json import TeamRunRecord, team_plans_json, team_record_json
from planopt.planning.given import Given
from planopt.planning.ground_reasons import obstacles_met
from planopt.planning.history import history_of
from planopt.planning.loop.channel_log import channel_log, channel_row
from planopt.planning.loop.robot_run import completed_run
from planopt.planning.loop.run import Outcome
from planopt.planning.loop.target_log import target_log, watched
from planopt.planning.loop.target_watch import TargetWatch, aim_of, watch_target
from planopt.planning.loop.true_serving import true_serving_dbm
from planopt.planning.plan import Plan
from planopt.planning.proof.circumstances import circumstances_of
from planopt.planning.proof.verify import judge
from planopt.planning.robot_problem import problem_of_robot
from planopt.planning.team.reservations import beside, others_of
from planopt.planning.team.team_certificate import worst_of_robots
from planopt.planning.team.team_ending import Progress, team_ending
from planopt.planning.team.team_run import ChannelLog
from planopt.planning.team.team_seeds import team_seeds
from planopt.planning.team.team_summary import summary_of
from planopt.planning.team.team_tables import (
    KNOWLEDGE_FILE,
    TARGET_FILE,
    knowledge_table,
    target_table,
)
from planopt.planning.worth.aim import Aim
from planopt.planning.worth.pending import counts_others, places_of_others
from planopt.planning.worth.region import workspace_region
from planopt.problems.problem import Problem
from planopt.robots.braked_motion import braked_motion
from planopt.robots.drive import Drive
from planopt.world.clearance import ObstacleIndex, index_obstacles
from planopt.world.timed_motion import TimedMotion


@dataclass(frozen=True, eq=False)
class _Driven:
    """What is found again of one robot: states, plans, aims, beliefs before and after each.

    And the objections to it.
    """

    states: NDArray[np.float64]
    plans: list[Plan]
    aims: list[Aim]
    posteriors: list[tuple[ChannelPosterior, ...]]
    reasons: list[str]


def check_team_run(
    saved: SavedTeam, record: TeamRunRecord, given: Given | None
) -> tuple[list[Certificate], list[str]]:
    """The worst certificate of each step over the robots, and every reason to reject.

    Parameters
    ----------
    saved, record
        What was read.
    given
        What problem and seed give, if it is to be had.
    """
    problem, seed = saved.problem, record.seed
    truths = () if given is None else given.truths
    index, region = index_obstacles(problem.workspace), workspace_region(problem)
    tracks = np.array([steps.positions_m for steps in saved.steps])
    true = np.array(
        [
            true_serving_dbm(problem, truths, track) if truths else steps.numbers["true_db"]
            for steps, track in zip(saved.steps, tracks, strict=True)
        ]
    )
    delivered = (true >= problem.stations[0].threshold_dbm)[:, 1:].T
    faults = _length_faults(problem, len(delivered)) + _plan_faults(saved, record)
    if faults:
        return [], faults
    seeds = team_seeds(problem, seed)
    watches = watched(watch_target(problem, seeds.target), tracks, delivered, seeds.target)
    released = [_released(saved, record, number) for number in range(len(problem.robots))]
    driven = [
        _driven(saved, record, number, index, region, watches, released, delivered[:, number])
        for number in range(len(problem.robots))
    ]
    taken = [
        taken_on_the_way(problem, belief, track, true_dbm)
        for belief, track, true_dbm in zip(saved.beliefs, tracks, true, strict=True)
    ]
    ended, reasons = _ended(problem, delivered, driven, [one.learnt for one in taken])
    runs = [
        completed_run(
            problem_of_robot(problem, number),
            seed,
            track,
            true_dbm,
            one.plans,
            measured.learnt,
            ended,
        )
        for number, (track, true_dbm, one, measured) in enumerate(
            zip(tracks, true, driven, taken, strict=True)
        )
    ]
    target = target_log(watches, delivered)
    if not truths:
        channel = _channel_as_said(saved)
    else:
        rows = [channel_row(p, truths, region.grid_m) for p in driven[0].posteriors]
        channel = channel_log(rows)
    found = {
        **team_record_json(problem, summary_of(problem, seed, runs, target, channel), runs),
        "plans": team_plans_json([one.plans for one in driven], [one.aims for one in driven]),
        "step_s": record.step_s.model_dump(),
        # What was asked is not judged: library_remarks says what there is to say.
        "problem_file": saved.data["problem_file"],
    }
    reasons += [reason for one in driven for reason in one.reasons]
    reasons += in_words(RUN_FILE, disagreements(saved.data, found))
    reasons += step_time_faults(record.step_s, sum(len(one.plans) for one in driven))
    again = joined_steps([steps_of_run(run.robot, run.log, run.drive) for run in runs])
    reasons += steps_reasons(joined_steps(saved.steps), again)
    tables = {KNOWLEDGE_FILE: knowledge_table(problem, channel)}
    if target is not None:
        tables[TARGET_FILE] = target_table(problem, target)
    for name, table in tables.items():
        reasons += in_words(
            name,
            disagreements(
                {column: values.tolist() for column, values in saved.tables[name].items()},
                {column: np.asarray(values).tolist() for column, values in table.items()},
            ),
        )
    for belief, one, measured in zip(saved.beliefs, driven, taken, strict=True):
        reasons += belief_reasons(problem, belief, one.posteriors[-1], given, measured, seed)
    return [
        worst_of_robots({plan.robot: plan.certificate for plan in made})
        for made in zip(*(one.plans for one in driven), strict=True)
    ], reasons


@dataclass(frozen=True, eq=False)
class _Released:
    """A released plan as it was saved: places (N + 1, 2), how they are driven, and when."""

    path_m: NDArray[np.float64]
    drive: Drive | None
    motion: TimedMotion


def _released(saved: SavedTeam, record: TeamRunRecord, number: int) -> list[_Released]:
    """Every plan of robot number `number`."""
    dynamics, step_s = saved.problem.robots[number].dynamics, saved.problem.planner.step_s
    found: list[_Released] = []
    for step, plan in enumerate(record.plans[number].released):
        path = np.stack([plan.x_m, plan.y_m], axis=1)
        key = f"plans[{number}].released[{step}].drive"
        drive = drive_of(dynamics, path, plan.drive, saved.file, key)
        found.append(_Released(path, drive, braked_motion(path, drive, step_s)))
    return found


def _driven(
    saved: SavedTeam,
    record: TeamRunRecord,
    number: int,
    index: ObstacleIndex,
    region: Region,
    watches: Sequence[TargetWatch | None],
    released_by: Sequence[Sequence[_Released]],
    connected: NDArray[np.bool_],
) -> _Driven:
    """Every plan of robot number `number` on what it knew, beside all that were released."""
    own = problem_of_robot(saved.problem, number)
    robot, belief, track = own.robots[0], saved.beliefs[number], saved.steps[number].positions_m
    place = f"plans[{number}].released"
    key = f"{RUN_FILE}, key {place}"
    table, dynamics = saved.file.parent / STEPS_FILE, robot.dynamics
    driven = drive_of(dynamics, track, saved.steps[number].motion, table, f"robot {robot.name}")
    states = track if driven is None else driven.states
    reasons: list[str] = []
    if driven is None:
        reasons += [f"{robot.name}: {text}" for text in obstacles_met(own, index, track)]
    if np.abs(states[0] - robot.start_state).max() > EXACT:
        reasons.append(f"{STEPS_FILE}: {robot.name} does not start at robots[{number}].start_m")
    posteriors = [first_posteriors(belief)]
    plans: list[Plan] = []
    aims: list[Aim] = []
    for step, released in enumerate(record.plans[number].released, start=1):
        watch = watches[step - 1]
        known = posteriors[-1] = posteriors_at(belief, posteriors[-1], step)
        posterior = known[0]
        own_plan = released_by[number][step - 1]
        path, drive = own_plan.path_m, own_plan.drive
        history = history_of(own, track[:step], connected[: step - 1])
        others = others_of([made[step - 1].motion for made in released_by], number)
        moving = beside(saved.problem, history.steps, others)
        circumstances = circumstances_of(own, known, history, moving)
        here, residual = states[step - 1], released.kkt_residual
        judgement = judge(own, index, posterior, here, path, residual, circumstances, drive)
        aim = aim_again(released.aim, aim_of(watch, number, own.planner.horizon))
        if counts_others(saved.problem):
            tracks = [made.positions_m[1:step] for made in saved.steps]
            aim = replace(
                aim, pending=replace(aim.pending, driven_m=places_of_others(tracks, number))
            )
        worth = worth_again(own, posterior, path, aim, region, circumstances, index)
        plan = rebuilt_plan(own, path, judgement, released, Effort(), worth, drive=drive)
        where = f"{key}[{step - 1}]"
        reasons += plan_reasons(own, index, where, step, plan, plans[-1] if plans else None)
        ahead = path if drive is None else drive.states
        if _leads_elsewhere(ahead, states, step):
            reasons.append(
                f"step {step} of {robot.name} in {STEPS_FILE} is not the first step of its plan, "
                f"{where}"
            )
        plans.append(plan)
        aims.append(aim)
        posteriors.append(known)
    posteriors[-1] = last_posteriors(belief, posteriors[-1])
    return _Driven(states, plans, aims, posteriors, reasons)


def _leads_elsewhere(planned: NDArray[np.float64], states: NDArray[np.float64], step: int) -> bool:
    return bool(np.abs(planned[:2] - states[step - 1 : step + 1]).max() > EXACT)


def _length_faults(problem: Problem, steps: int) -> list[str]:
    """No run is longer than the problem says; nothing can be judged where one is."""
    if steps <= problem.planner.max_steps:
        return []
    most = problem.planner.max_steps
    return [f"{STEPS_FILE}: the run ends after step {steps}, planner.max_steps is {most}"]


def _ended(
    problem: Problem,
    connected: NDArray[np.bool_],
    driven: Sequence[_Driven],
    learnt: Sequence[list[bool]],
) -> tuple[tuple[Outcome, str], list[str]]:
    """How the run ended and why in words, and what is wrong with where it did."""
    steps = len(connected)
    for step in range(1, steps + 1):
        robots = [
            Progress(
                problem_of_robot(problem, number),
                list(one.states[: step + 1]),
                measured[:step],
                one.plans[:step],
                one.posteriors[step],
            )
            for number, (one, measured) in enumerate(zip(driven, learnt, strict=True))
        ]
        ended = team_ending(problem, connected[:step], robots)
        if ended is not None:
            late = f"{STEPS_FILE}: the run goes on after step {step}, {ended[1]}"
            return ended, [late] if step < steps else []
    short = f"{STEPS_FILE}: the run ends after step {steps}, planner.max_steps is "
    return (Outcome.STEP_LIMIT, ""), [f"{short}{problem.planner.max_steps}"]


def _plan_faults(saved: SavedTeam, record: TeamRunRecord) -> list[str]:
    """Plans are as long as the problem says."""
    planner = saved.problem.planner
    faults: list[str] = []
    for number, robot in enumerate(record.plans):
        for step, released in enumerate(robot.released):
            if len(released.x_m) != planner.horizon + 1:
                faults.append(
                    f"{RUN_FILE}, key plans[{number}].released[{step}]: has "
                    f"{len(released.x_m) - 1} steps, planner.horizon is {planner.horizon}"
                )
    return faults


def _channel_as_said(saved: SavedTeam) -> ChannelLog:
    table = saved.tables[KNOWLEDGE_FILE]
    return ChannelLog(table["rms_db"], table["anmse_db"], table["trace_m_db"], table["log_det_m"])
