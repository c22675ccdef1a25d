"""Closed loop of a run: plan, move, measure and update the belief until the run ends."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.channel.ground_truth import Truth, measure
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import Belief, ChannelPosterior
from planopt.errors import NoPlanError
from planopt.objectives.terms.term import Pending
from planopt.planning.certificate import BlockedError, BlockedPath
from planopt.planning.loop.log import ChannelLog, Outcome, channel_row, target_log
from planopt.planning.loop.metrics import robot_run, run_costs, true_serving_dbm
from planopt.planning.loop.results import Run
from planopt.planning.plan import Plan, Rung, Verdict
from planopt.planning.proof.motion import is_at_goal, stands
from planopt.planning.stepping import Planning, Stepper, TargetWatch
from planopt.planning.tolerances import CLEARANCE_PAD_M, STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import (
    anticipated,
    counts_others,
    learns,
    left_to_learn,
    places_of_others,
    workspace_region,
)
from planopt.problems.problem import Problem
from planopt.targets.information_filter import sense
from planopt.world.clearance import index_obstacles
from planopt.world.lattice import RoadMap, build_lattice

STALL_STEPS = 30
"""Number of steps without a new measurement, near one position, that count as a stall."""


@dataclass(frozen=True, eq=False)
class Progress:
    """Record of one robot's progress in a closed loop, for its termination."""

    problem: Problem  # Problem restricted to this robot
    states: Sequence[Floats]  # States (s,), position first: at the start and after each step
    learnt: Sequence[bool]  # Whether each step yielded a measurement
    plans: Sequence[Plan]  # The plan whose first step was executed, by step
    posteriors: Sequence[ChannelPosterior]  # Current belief about each station's channel


def goals_ending(problem: Problem, robots: Sequence[Progress]) -> tuple[Outcome, str] | None:
    """Return outcome and reason for a run to goals; None while any robot can continue."""
    # Arrived and waiting robots can still give way to others.
    ends = [_goal_ending(each) for each in robots]
    if len(robots) == 1:
        return ends[0]
    late = [
        each.problem.robots[0].name
        for each, end in zip(robots, ends, strict=True)
        if end is None or end[0] is not Outcome.REACHED
    ]
    if not late:
        radius_m = problem.constraints.goal_radius_m
        return Outcome.REACHED, f"all robots within {radius_m:g} m of their goals"
    if len(robots[0].learnt) >= problem.planner.max_steps:
        words = f"{', '.join(late)} not arrived after {problem.planner.max_steps} steps"
        return Outcome.STEP_LIMIT, words
    stay = all(_stays(each.states, each.problem.step_length_m) for each in robots)
    if None in ends or not stay:
        return None
    stuck = [
        (each, end[1])
        for each, end in zip(robots, ends, strict=True)
        if end is not None and end[0] is Outcome.STALLED
    ]
    return Outcome.STALLED, _in_words(problem, stuck)


def _goal_ending(robot: Progress) -> tuple[Outcome, str] | None:
    """Return outcome and reason for a robot's run to its goal; None while the run continues."""
    problem, learnt = robot.problem, robot.learnt
    if _has_arrived(problem, robot.states[-1]):
        where = "within" if robot.plans else "the start is within"
        return Outcome.REACHED, f"{where} {problem.constraints.goal_radius_m:g} m of the goal"
    why = _circling(robot) if robot.plans else None
    if why is not None and not problem.workspace.moving:
        return Outcome.STALLED, why
    if len(learnt) >= problem.planner.max_steps:
        return Outcome.STEP_LIMIT, f"not arrived after {problem.planner.max_steps} steps"
    return None


def _circling(robot: Progress) -> str | None:
    """Return the reason if a robot stays near one position without new measurements, else None."""
    step_m, plan = robot.problem.step_length_m, robot.plans[-1]
    if any(robot.learnt[-STALL_STEPS:]) or not _stays(robot.states, step_m):
        return None
    return (
        f"within {2 * step_m:g} m of one place for {STALL_STEPS} steps, "
        f"with nothing new to learn{plan.message and ': ' + plan.message}"
    )


def _stays(track: Sequence[Floats], step_length_m: float) -> bool:
    """Return whether a robot stayed within two step lengths of a position for `STALL_STEPS`."""
    if len(track) <= STALL_STEPS:
        return False
    recent = np.array(track[-STALL_STEPS - 1 :])[:, :2]
    return bool(np.linalg.norm(recent - recent[0], axis=1).max() <= 2.0 * step_length_m)


def terms_ending(
    problem: Problem, connected: Mask, robots: Sequence[Progress]
) -> tuple[Outcome, str] | None:
    """Return outcome and reason for a run with a sum of terms; None while the run continues."""
    # The run ends if all robots that have to connect are connected, if all with goals have arrived,
    # if no robot can make progress, or after `planner.max_steps`. It has stalled if all robots are
    # stuck (at the step limit: any robot), unless no position is left to measure.
    # Shapes: connected (steps, robots).
    steps, term = len(connected), problem.terms[0]
    waiting = [robot.problem.terms[0].steers == "connection" for robot in robots]
    if term.steers == "connection" and bool(connected[-1, waiting].all()):
        return Outcome.COMPLETED, f"connected after step {steps}"
    led = [r for r in robots if any(term.steers == "goal" for term in r.problem.terms)]
    if led and all(_has_arrived(robot.problem, robot.states[-1]) for robot in led):
        radius_m = problem.constraints.goal_radius_m
        return Outcome.REACHED, f"within {radius_m:g} m of the goal after step {steps}"
    last = steps >= problem.planner.max_steps
    stuck = [
        (robot, why)
        for number, robot in enumerate(robots)
        if (why := _stuck(problem, connected[:, number], robot)) is not None
    ]
    if stuck and (last or len(stuck) == len(robots)):
        stuck = [
            (robot, why)
            for robot, why in stuck
            if not learns(robot.problem) or _has_left(problem, robots, robot)
        ]
        if stuck:
            return Outcome.STALLED, _in_words(problem, stuck)
        if not last:
            return Outcome.COMPLETED, f"nothing left to learn after step {steps}"
    if not last:
        return None
    if led:
        return Outcome.STEP_LIMIT, f"not arrived after planner.max_steps {steps}"
    if term.steers == "connection":
        return Outcome.STEP_LIMIT, f"not connected after planner.max_steps {steps}"
    return Outcome.COMPLETED, f"all {steps} steps driven"


def _has_arrived(problem: Problem, state: Floats) -> bool:
    """Return whether a robot is at rest at its goal."""
    return is_at_goal(problem, state[:2]) and stands(problem, state)


def _stuck(problem: Problem, connected: Mask, robot: Progress) -> str | None:
    """Return the reason why a robot waits or circles without further progress, else None."""
    recent, term = slice(-STALL_STEPS, None), robot.problem.terms[0]
    if term.sensor is not None and connected[recent].any():
        return None
    if term.task == "custom" and term.steers is None and not learns(robot.problem):
        verdicts = [plan.verdict for plan in robot.plans[recent]]
        if any(verdict is Verdict.VERIFIED for verdict in verdicts):
            return None
    interacts = problem.constraints.separation_m > 0.0 or counts_others(problem)
    apart = len(problem.robots) > 1 and interacts
    alone = not apart and term.sensor is None and problem.planner.name != "random"
    own, track, plan = robot.problem, robot.states, robot.plans[-1]
    unit = np.array(own.robots[0].dynamics.unit_m(own.planner.step_s))
    stood = bool(np.linalg.norm((track[-1] - track[-2]) * unit) <= STANDSTILL_M)
    # A plan that moves after waiting gives the next plan another initial guess.
    waits = np.linalg.norm(plan.positions_m - plan.positions_m[0], axis=1).max() > STANDSTILL_M
    # At the same position, belief, obstacles and time, the next plan is the same.
    again = plan.rung is not Rung.SHIFTED and not own.workspace.moving and alone
    again &= own.planner.budget_s is None
    if stood and not waits and not robot.learnt[-1] and again:
        return f"standing still with nothing new to learn{plan.message and ': ' + plan.message}"
    return _circling(robot)


def _has_left(team: Problem, robots: Sequence[Progress], robot: Progress) -> bool:
    """Return whether unmeasured positions remain for a robot, given the others' measurements."""
    problem, states, others = robot.problem, robot.states, Pending()
    if counts_others(team):
        driven = [np.array(each.states)[1:, :2] for each in robots]
        number = next(number for number, each in enumerate(robots) if each is robot)
        others = Pending((), places_of_others(driven, number))
    spacing = problem.channel.measure_spacing_m
    posteriors = anticipated(robot.posteriors, others, states[-1][:2], spacing)
    lattice = build_lattice(
        problem.workspace,
        states[0][:2],
        problem.step_length_m - STEP_PAD_M,
        problem.constraints.clearance_m + CLEARANCE_PAD_M,
    )
    index = index_obstacles(problem.workspace)
    return len(left_to_learn(problem, index, lattice, states[-1][:2], posteriors)) > 0


def _in_words(problem: Problem, stuck: Sequence[tuple[Progress, str]]) -> str:
    """Return text on the robots that wait or circle, with reasons."""
    unmeasured = any(learns(robot.problem) for robot, _ in stuck)
    whys = [
        f"{robot.problem.robots[0].name}: {why}" if len(problem.robots) > 1 else why
        for robot, why in stuck
    ]
    return "; ".join(whys) + ("; places are left to measure" if unmeasured else "")


@dataclass(frozen=True, eq=False)
class World:
    """Radio channel that robots measure, with functions that record the run."""

    truths: tuple[Truth, ...]  # Ground truth by station; empty if unknown
    # Maps robot number, step and positions (n, 2) from that step on to serving power (n,)
    serving_dbm: Callable[[int, int, Floats], Floats]
    # Maps step and robot positions (robots, 2) to measurements by robot and station
    measured: Callable[[int, Floats], list[list[Measurements]]]
    # Maps step, posteriors by station and positions (n, 2) to a row of the channel log
    channel_row: Callable[[int, Sequence[ChannelPosterior], Floats], tuple[float, ...]]
    # Maps tracks (steps + 1, 2) by robot to true costs by metric; empty without goals
    costs: Callable[[Sequence[Floats], Outcome], dict[str, float]]


def true_world(
    problem: Problem,
    truths: tuple[Truth, ...],
    road_maps: Callable[[], Sequence[RoadMap]],  # One per robot with a goal
) -> World:
    """Return the simulated world whose measurements are drawn from a known ground truth."""
    return World(
        truths=truths,
        serving_dbm=lambda _number, _step, places: true_serving_dbm(problem, truths, places),
        measured=lambda _step, places: [
            [measure(truth, place[None]) for truth in truths] for place in places
        ],
        channel_row=lambda _step, posteriors, places: channel_row(posteriors, truths, places),
        costs=lambda tracks, outcome: run_costs(problem, road_maps(), truths, tracks, outcome),
    )


def drive(
    problem: Problem,
    seed: int,
    belief: Belief,
    world: World,
    planning: Planning,
    target: TargetWatch | None,
    generator: np.random.Generator,  # Noise of target sensors
    *,
    on_start: Callable[[Sequence[Plan]], None] | None = None,
    on_plans: Callable[[int, Sequence[Plan]], None] | None = None,
    on_step: Callable[[int], None] | None = None,
) -> Run:
    """Run the loop until its task is done, the robots stall, or the step limit is reached."""
    robots = Stepper(problem, belief, planning, target)
    # Errors over the whole workspace are slow to compute and not needed for runs to a goal.
    known_at = None if problem.has_goal else workspace_region(problem).grid_m
    rows: list[tuple[float, ...]] = []
    if known_at is not None:
        rows.append(world.channel_row(0, robots.beliefs[0].posteriors, known_at))
    ended, blocked = _ending(robots), tuple[BlockedPath, ...]()
    while ended is None:
        try:
            step_plans = robots.plan()
        except NoPlanError as error:
            ended = Outcome.NO_PLAN, str(error)
            blocked = error.blocked if isinstance(error, BlockedError) else ()
            break
        step = len(robots.connected) + 1
        if step == 1 and on_start is not None:
            on_start(step_plans)
        if on_plans is not None:
            on_plans(step, step_plans)
        _observe(robots, [plan.next_state for plan in step_plans], world, generator)
        if known_at is not None:
            rows.append(world.channel_row(step, robots.beliefs[0].posteriors, known_at))
        if on_step is not None:
            on_step(step)
        ended = _ending(robots)
    tracks = [np.array(driven)[:, :2] for driven in robots.states]
    return Run(
        problem=problem,
        seed=seed,
        truths=world.truths,
        runs=tuple(
            robot_run(own, track, world.serving_dbm(number, 0, track), made, measured, ended)
            for number, (own, track, made, measured) in enumerate(
                zip(robots.owns, tracks, robots.plans, robots.learnt, strict=True)
            )
        ),
        plans=tuple(tuple(made) for made in robots.plans),
        aims=tuple(tuple(known) for known in robots.aims),
        beliefs=tuple(robots.beliefs),
        first_measurements=len(belief.posterior.measurements),
        target=target_log(robots.watches, robots.connected),
        channel=ChannelLog(*np.asarray(rows, dtype=np.float64).T) if rows else None,
        costs=world.costs(tracks, ended[0]),
        blocked=blocked,
    )


def first_steps(
    problem: Problem,
    belief: Belief,
    world: World,
    planning: Planning,
    target: TargetWatch | None,
    generator: np.random.Generator,
    count: int,
    recorded: Sequence[Sequence[Sequence[float]]] = (),  # (steps, robots, state)
) -> tuple[list[list[Plan]], list[list[Floats]]]:
    """Return plans and states of a run's first steps, by step and robot."""
    # Robots are set to recorded states, if any, so that rounding errors do not accumulate.
    robots = Stepper(problem, belief, planning, target)
    made: list[list[Plan]] = []
    for step in range(len(recorded) or count):
        if not recorded and _ending(robots) is not None:
            break
        made.append(robots.plan())
        states = (
            [np.array(state) for state in recorded[step]]
            if recorded
            else [plan.next_state for plan in made[-1]]
        )
        _observe(robots, states, world, generator)
    by_robot = [driven[1:] for driven in robots.states]
    return made, [list(states) for states in zip(*by_robot, strict=True)]


def _observe(
    robots: Stepper, states: Sequence[Floats], world: World, generator: np.random.Generator
) -> None:
    """Move the robots to new states, and update their beliefs with measurements."""
    step, watch = len(robots.connected) + 1, robots.watches[-1]
    here = np.array([state[:2] for state in states])
    serving = [world.serving_dbm(number, step, place[None])[0] for number, place in enumerate(here)]
    robots.observe(
        states,
        world.measured(step, here),
        np.array(serving) >= robots.problem.stations[0].true_threshold_dbm,
        None if watch is None else sense(watch.sensor, here, watch.true_m[step], generator),
    )


def _ending(robots: Stepper) -> tuple[Outcome, str] | None:
    """Return outcome and reason for a run at the current states; None if it continues."""
    progress = [
        Progress(own, driven, measured, made, belief.posteriors)
        for own, driven, measured, made, belief in zip(
            robots.owns, robots.states, robots.learnt, robots.plans, robots.beliefs, strict=True
        )
    ]
    if robots.problem.has_goal:
        return goals_ending(robots.problem, progress)
    connected = robots.connected
    return terms_ending(robots.problem, connected, progress) if len(connected) else None
