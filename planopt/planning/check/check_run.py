"""Judge a saved run: every released plan on what its robot knew then, and all that follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.fields.truth import Truth
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.certificate import Certificate
from planopt.planning.check.agreement import EXACT, disagreements, in_words, without_searched
from planopt.planning.check.check_belief import (
    Taken,
    belief_again,
    belief_reasons,
    learnt_again,
    taken_on_the_way,
)
from planopt.planning.check.check_plan import of_robot, order_faults, pending_faults
from planopt.planning.check.check_steps import steps_reasons
from planopt.planning.check.rebuilt import (
    Asked,
    Effort,
    Place,
    obstacles_met_then,
    places_of,
    provenance_faults,
    rebuilt_plan,
)
from planopt.planning.files.belief_file import first_posteriors, last_posteriors, posteriors_at
from planopt.planning.files.drive_table import drive_of
from planopt.planning.files.read_saved import Saved
from planopt.planning.files.run_json import (
    RunRecord,
    StepTimesRecord,
    released_plans_json,
    run_json,
)
from planopt.planning.files.saved import FORMAT, RUN_FILE
from planopt.planning.files.solution_json import aim_again, blocked_again
from planopt.planning.files.steps_file import (
    FORMER_KNOWLEDGE_COLUMNS,
    KNOWLEDGE_COLUMNS,
    KNOWLEDGE_FILE,
    STEPS_FILE,
    joined_steps,
    run_tables,
    steps_of_run,
)
from planopt.planning.free_space import is_joined, obstacles_met
from planopt.planning.given import Given, team_seeds
from planopt.planning.history import history_of
from planopt.planning.holes import BlockedWay
from planopt.planning.loop.clairvoyant import COSTS, run_costs
from planopt.planning.loop.ending import Progress, run_ending
from planopt.planning.loop.log import (
    ChannelLog,
    Outcome,
    channel_log,
    channel_row,
    target_log,
    watched,
)
from planopt.planning.loop.robot_run import robot_run, true_serving_dbm
from planopt.planning.loop.target_watch import TargetWatch, aim_of, watch_target
from planopt.planning.plan import Plan, Rung
from planopt.planning.proof.circumstances import circumstances_of
from planopt.planning.proof.goal_paths import GoalGrid
from planopt.planning.roads import build_roads
from planopt.planning.run import Run
from planopt.planning.team.reservations import beside, others_of, worst_of_robots
from planopt.planning.worth.situation import Aim, counts_others, places_of_others
from planopt.problems.problem import Problem, problem_at, problem_of_robot
from planopt.robots.drive import Drive, braked_motion
from planopt.world.clearance import ObstacleIndex
from planopt.world.timed_motion import TimedMotion

LATER_KEYS = {"excused", "relaxation_db", "best_margin_db"}
"""Keys of robots and released plans that runs of format 2 did not have at first; for one version
they may be missing, all of them together."""


@dataclass(frozen=True, eq=False)
class _Driven:
    """The states, plans, aims and beliefs of one robot, found again.

    And the objections to it.
    """

    states: NDArray[np.float64]
    plans: list[Plan]
    aims: list[Aim]
    posteriors: list[tuple[ChannelPosterior, ...]]
    reasons: list[str]


@dataclass(frozen=True, eq=False)
class _Rebuilt:
    """A run as it must be, what each robot measured on the way, and objections to its plans."""

    run: Run
    taken: list[Taken]
    reasons: list[str]


def check_run(
    saved: Saved, record: RunRecord, given: Given | None
) -> tuple[list[Certificate], list[str]]:
    """Return the worst certificate of each step over the robots, and every reason to reject."""
    problem = saved.problem
    learnt, unfitted = learnt_again(problem, saved.beliefs)
    if faults := length_faults(saved, record) or unfitted:
        return [], faults
    rebuilt = rebuilt_run(saved, record, learnt, () if given is None else given.truths)
    run, reasons = rebuilt.run, rebuilt.reasons
    said = saved.data.get("metrics")
    found: dict[str, Any] = {
        "format": FORMAT,
        **run_json(run),
        "plans": released_plans_json(run),
        "step_s": record.step_s.model_dump(),
        # What was asked is not judged: library_remarks says what there is to say.
        "problem_file": saved.data["problem_file"],
    }
    if saved.former and isinstance(said, Mapping):
        # Former versions knew fewer metrics.
        found["metrics"] = {key: found["metrics"][key] for key in found["metrics"] if key in said}
    _drop_later_keys(_robots_and_plans(found), _robots_and_plans(saved.data))
    reasons += in_words(
        RUN_FILE, disagreements(without_searched(saved.data), without_searched(found))
    )
    reasons += _step_time_faults(record.step_s, sum(len(made) for made in run.plans))
    again = joined_steps([steps_of_run(one.robot, one.log, one.drive) for one in run.runs])
    reasons += steps_reasons(joined_steps(saved.steps), again)
    for name, table in run_tables(run).items():
        shorter = saved.former and name == KNOWLEDGE_FILE
        columns = FORMER_KNOWLEDGE_COLUMNS if shorter else table
        reasons += in_words(
            name,
            disagreements(
                {column: saved.tables[name][column].tolist() for column in columns},
                {column: np.asarray(table[column]).tolist() for column in columns},
            ),
        )
    for file, first, belief, taken in zip(
        saved.beliefs, learnt, run.beliefs, rebuilt.taken, strict=True
    ):
        known = belief.posteriors
        reasons += belief_reasons(problem, file, first, known, given, taken, record.seed)
    return [
        worst_of_robots({plan.robot: plan.certificate for plan in made})
        for made in zip(*run.plans, strict=True)
    ], reasons


def rebuilt_run(
    saved: Saved, record: RunRecord, learnt: Sequence[Sequence[Belief]], truths: Sequence[Truth]
) -> _Rebuilt:
    """Return the run as it must be, with every objection to its plans and its end."""
    problem, numbers = saved.problem, range(len(saved.problem.robots))
    places = places_of(problem, len(saved.steps[0].steps))
    tracks = np.array([steps.positions_m for steps in saved.steps])
    true = np.array(
        [
            true_serving_dbm(problem, truths, track) if truths else steps.numbers["true_db"]
            for steps, track in zip(saved.steps, tracks, strict=True)
        ]
    )
    connected = (true >= problem.stations[0].true_threshold_dbm)[:, 1:].T
    seeds = team_seeds(problem, record.seed)
    watches = watched(watch_target(problem, seeds.target), tracks, connected, seeds.target)
    released = [_released(saved, record, number) for number in numbers]
    driven = [
        _driven(saved, record, number, places, watches, released, connected[:, number])
        for number in numbers
    ]
    shares = problem.channel.share_measurements
    measuring = [list(numbers) if shares else [number] for number in numbers]
    taken = [
        taken_on_the_way(problem, belief, tracks[those], true[those])
        for belief, those in zip(saved.beliefs, measuring, strict=True)
    ]
    names = [robot.name for robot in problem.robots]
    blocked = blocked_again(record.blocked, names, saved.file)
    ended, reasons = _ended(saved, connected, driven, [one.learnt for one in taken], blocked)
    for step, aims in enumerate(zip(*(one.aims for one in driven), strict=True)):
        faults = order_faults(problem, aims)
        reasons += [f"{RUN_FILE}, key plans[].released[{step}]: {fault}" for fault in faults]
    run = Run(
        problem=problem,
        seed=record.seed,
        truths=tuple(truths),
        runs=tuple(
            robot_run(
                problem_of_robot(problem, number),
                tracks[number],
                true[number],
                one.plans,
                taken[number].learnt,
                ended,
            )
            for number, one in enumerate(driven)
        ),
        plans=tuple(tuple(one.plans) for one in driven),
        aims=tuple(tuple(one.aims) for one in driven),
        beliefs=tuple(
            belief_again(first, one.posteriors[-1])
            for first, one in zip(learnt, driven, strict=True)
        ),
        first_measurements=saved.beliefs[0].first,
        target=target_log(watches, connected),
        channel=_channel(saved, places[0], truths, driven[0].posteriors),
        costs=_costs(saved, truths, list(tracks), ended[0]),
        blocked=blocked,
    )
    reasons += [reason for one in driven for reason in one.reasons]
    return _Rebuilt(run, taken, reasons)


def _channel(
    saved: Saved,
    place: Place,
    truths: Sequence[Truth],
    posteriors: Sequence[Sequence[ChannelPosterior]],
) -> ChannelLog | None:
    """Return how well the first robot knew the channel; as it is said where there is no truth."""
    if place.region is None:
        return None
    if truths:
        return channel_log([channel_row(p, truths, place.region.grid_m) for p in posteriors])
    table = saved.tables[KNOWLEDGE_FILE]
    return ChannelLog(*(table[name] for name in KNOWLEDGE_COLUMNS[1:]))


def _costs(
    saved: Saved,
    truths: Sequence[Truth],
    tracks_m: Sequence[NDArray[np.float64]],
    outcome: Outcome,
) -> dict[str, float]:
    """Return what a run to a goal cost; as it is said where there is no truth.

    As it is said in former results, too, which charged each step by its end.
    """
    problem = saved.problem
    if problem.task != "reach":
        return {}
    if truths and not saved.former:
        owns = [problem_of_robot(problem, number) for number in range(len(problem.robots))]
        roads = [build_roads(own, np.asarray(own.goal_m)) for own in owns]
        return run_costs(problem, roads, truths, tracks_m, outcome)
    said: Mapping[str, float] = saved.data.get("metrics", {})
    return {key: said[key] for key in COSTS if key in said}


@dataclass(frozen=True, eq=False)
class _Released:
    """A released plan as it was saved: places (N + 1, 2), how they are driven, and when."""

    path_m: NDArray[np.float64]
    drive: Drive | None
    motion: TimedMotion


def _released(saved: Saved, record: RunRecord, number: int) -> list[_Released]:
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
    saved: Saved,
    record: RunRecord,
    number: int,
    places: Sequence[Place],
    watches: Sequence[TargetWatch | None],
    released_by: Sequence[Sequence[_Released]],
    connected: NDArray[np.bool_],
) -> _Driven:
    """Every plan of robot number `number` on what it knew, beside all that were released."""
    own, place = problem_of_robot(saved.problem, number), places[0]
    robot, belief, track = own.robots[0], saved.beliefs[number], saved.steps[number].positions_m
    key = f"{RUN_FILE}, key plans[{number}].released"
    table, dynamics = saved.file.parent / STEPS_FILE, robot.dynamics
    driven = drive_of(dynamics, track, saved.steps[number].motion, table, f"robot {robot.name}")
    states = track if driven is None else driven.states
    reasons: list[str] = []
    if driven is None:
        met = obstacles_met_then(saved.problem, places, track)
        reasons += of_robot(saved.problem, robot.name, met)
    if np.abs(states[0] - robot.start_state).max() > EXACT:
        reasons.append(f"{STEPS_FILE}: {robot.name} does not start at robots[{number}].start_m")
    posteriors = [first_posteriors(belief)]
    plans: list[Plan] = []
    aims: list[Aim] = []
    goal_grid: GoalGrid | None = None
    for step, said in enumerate(record.plans[number].released, start=1):
        if places[step - 1] is not place:
            place, goal_grid = places[step - 1], None
            own = problem_of_robot(problem_at(saved.problem, step - 1), number)
        known = posteriors[-1] = posteriors_at(belief, posteriors[-1], step)
        released = released_by[number][step - 1]
        proofs = [plan.certificate for plan in plans]
        yielded = [plan.rung is Rung.GIVE_WAY for plan in plans]
        history = history_of(own, track[:step], connected[: step - 1], proofs, gave_way=yielded)
        others = others_of([made[step - 1].motion for made in released_by], number)
        moving = beside(saved.problem, history.steps, others)
        aim = aim_again(said.aim, aim_of(watches[step - 1], number, own.planner.horizon))
        if counts_others(own):
            driven_m = [made.positions_m[1:step] for made in saved.steps]
            told = replace(aim.pending, driven_m=places_of_others(driven_m, number))
            aim = replace(aim, pending=told)
        paths = [made[step - 1].path_m for made in released_by]
        reasons += [
            f"{key}[{step - 1}].aim.{fault}"
            for fault in pending_faults(aim, paths, number, own.planner.rounds)
        ]
        under = circumstances_of(own, known, history, moving, goal_grid)
        asked = Asked(own, place, known, states[step - 1], aim, under)
        plan = rebuilt_plan(
            asked, released.path_m, released.drive, said, said.kkt_residual, Effort()
        )
        goal_grid = under.laid_grid
        where = f"{key}[{step - 1}]"
        reasons += _plan_reasons(own, place.index, where, step, plan, plans[-1] if plans else None)
        ahead = released.path_m if released.drive is None else released.drive.states
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


def _plan_reasons(
    problem: Problem,
    index: ObstacleIndex,
    where: str,
    step: int,
    plan: Plan,
    previous: Plan | None,
) -> list[str]:
    """Return what is wrong with one released plan."""
    objections = list(plan.certificate.reasons)
    if objections and plan.drive is None:
        objections[:0] = obstacles_met(problem, index, plan.positions_m)
    return [
        *(f"{where}, the plan for step {step}: {objection}" for objection in objections),
        *(f"{where}.{key}: {fault}" for key, fault in provenance_faults(problem, plan, previous)),
    ]


def _is_cut_off(problem: Problem, driven: Sequence[_Driven]) -> bool:
    """Return whether obstacles cut a robot off from its goal where it is at the end, exactly."""
    for number, one in enumerate(driven):
        own = problem_of_robot(problem, number)
        x, y = one.states[-1][:2].tolist()
        here = replace(own, robots=(replace(own.robots[0], start_m=(x, y)),))
        if here.task == "reach" and not is_joined(here, here.constraints.clearance_m):
            return True
    return False


def _ended(
    saved: Saved,
    connected: NDArray[np.bool_],
    driven: Sequence[_Driven],
    learnt: Sequence[list[bool]],
    blocked: Sequence[BlockedWay],
) -> tuple[tuple[Outcome, str], list[str]]:
    """Return how the run ended, why in words, and what is wrong with where it did.

    That a hard bound leaves no way from where the robots are is taken as it stands: the search is
    not repeated.
    """
    problem, steps = saved.problem, len(connected)
    now = problem
    for step in range(steps + 1):
        # What a step shows is judged in the workspace that it was planned in.
        now = problem_at(now, max(step - 1, 0))
        robots = [
            Progress(
                problem_of_robot(now, number),
                list(one.states[: step + 1]),
                measured[:step],
                one.plans[:step],
                one.posteriors[step],
            )
            for number, (one, measured) in enumerate(zip(driven, learnt, strict=True))
        ]
        ended = run_ending(now, connected[:step], robots)
        if ended is not None:
            late = f"{STEPS_FILE}: the run goes on after step {step}, {ended[1]}"
            return ended, [late] if step < steps else []
    no_plan = saved.data.get("outcome") == Outcome.NO_PLAN.value
    hard = problem.constraints.rule.slack_max_db is not None
    if no_plan and (
        (hard and _begins_at_end(problem, blocked, driven))
        or _is_cut_off(problem_at(now, steps), driven)
    ):
        return (Outcome.NO_PLAN, str(saved.data.get("message"))), []
    short = (
        f"{STEPS_FILE}: the run ends after step {steps}, planner.max_steps is "
        f"{problem.planner.max_steps}, and neither its task nor a standstill ended it"
    )
    return (Outcome.STEP_LIMIT, ""), [short]


def _begins_at_end(
    problem: Problem, blocked: Sequence[BlockedWay], driven: Sequence[_Driven]
) -> bool:
    """Return whether a forbidden way begins where its robot is at the end, and crosses a hole."""
    ends = {
        robot.name: one.states[-1][:2] for robot, one in zip(problem.robots, driven, strict=True)
    }
    return any(
        min(len(way.holes), len(way.way_m)) > 0
        and np.abs(way.way_m[0] - ends[way.robot]).max() <= EXACT
        for way in blocked
    )


def _robots_and_plans(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return what a run says of its robots, and of each released plan."""
    return [*data["robots"], *(plan for one in data["plans"] for plan in one["released"])]


def _drop_later_keys(found: list[dict[str, Any]], said: list[dict[str, Any]]) -> None:
    """Leave out keys that a run saved before they were there cannot have: it has none of them."""
    if any(LATER_KEYS & one.keys() for one in said):
        return
    # Only plans to a goal had `relaxed_steps` then.
    for one, other in zip(found, said, strict=True):
        for key in {*LATER_KEYS, "relaxed_steps"} - other.keys():
            one.pop(key, None)


def length_faults(saved: Saved, record: RunRecord) -> list[str]:
    """Return what is wrong with the lengths of a run and of its plans.

    No run is longer than the problem says, and its plans are as long; nothing can be judged where
    they are not.
    """
    planner, steps = saved.problem.planner, len(saved.steps[0].steps) - 1
    faults: list[str] = []
    if steps > planner.max_steps:
        faults.append(
            f"{STEPS_FILE}: the run ends after step {steps}, planner.max_steps is "
            f"{planner.max_steps}"
        )
    for number, robot in enumerate(record.plans):
        for step, released in enumerate(robot.released):
            if len(released.x_m) != planner.horizon + 1:
                faults.append(
                    f"{RUN_FILE}, key plans[{number}].released[{step}]: has "
                    f"{len(released.x_m) - 1} steps, planner.horizon is {planner.horizon}"
                )
    return faults


def _step_time_faults(times: StepTimesRecord, steps: int) -> list[str]:
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
