"""One step of all robots, with goals of their own (equation 6.11) or a sum of terms.

Timed paths to all goals (*courses*) are searched in sequence. A robot without a course moves to the
front of the order and the search restarts; the order is kept for the next step. Without courses, or
if a robot with dynamics cannot drive its own, robots avoid reservations
(:mod:`planopt.planning.reservations`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from planopt.arrays import Floats
from planopt.channel.posterior import Belief
from planopt.objectives.moments import Region
from planopt.objectives.terms.term import NOTHING_PENDING, Aim, Pending, SteeringPath, Steers
from planopt.planning.candidates import Scorer
from planopt.planning.initial_data import TeamSeeds
from planopt.planning.plan import BEGINNING, History, Plan, Rung, Verdict
from planopt.planning.planners import FollowingPlanner, Planner, plan_of, planner_for
from planopt.planning.proof.motion import is_at_goal
from planopt.planning.proof.rule import SEARCH_EXACT_LIMIT, obstacles_ahead, verifier_context
from planopt.planning.reach_planner import Course, Outlook, ReachPlanner
from planopt.planning.reservations import (
    discs_to_avoid,
    planned_motion,
    reserved_motion,
    with_separations,
)
from planopt.planning.scene import Ground, Scene, build_ground, build_scenes
from planopt.planning.search.steering import ConnectionSteering, GoalSteering, Steering
from planopt.planning.search.timed_search import DELAYS_STEPS, is_apart, timed_places
from planopt.planning.stepping import Planning, PlanStep, TeamMoment
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M, STEP_PAD_M
from planopt.planning.values.context import (
    StepContext,
    counts_others,
    places_of_others,
    step_context,
    workspace_region,
)
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.problems.problem import Problem, problem_of_robot
from planopt.problems.settings import OWN
from planopt.world.motion import NOTHING_MOVES, MovingDiscs, TimedMotion, joined_discs

Steer = Callable[[StepContext], SteeringPath | None]
"""Function that maps a step context to the robot's steering path."""
STEERINGS: Mapping[Steers, Callable[[Problem, Ground, Any], Any]] = {
    "variance": Steering,
    "connection": ConnectionSteering,
    "goal": GoalSteering,
}
"""Classes that find the steering path of a term, constructed from problem, ground and term."""
PlanOne = Callable[[int, MovingDiscs, Floats, Mapping[int, Plan]], Plan]
"""Function that plans for one robot: number, moving discs, reservation, earlier plans."""


def plan_in_turn(
    problem: Problem,
    moment: TeamMoment,
    order: Sequence[int],
    kept: Mapping[int, TimedMotion],
    plan_one: PlanOne,
) -> list[Plan]:
    """Return plans made in `order` that avoid earlier plans and the reserved motions `kept`."""
    made: dict[int, Plan] = {}
    for number in order:
        others = {
            other: planned_motion(problem, made[other]) if other in made else kept[other]
            for other in range(len(order))
            if other != number and (other in made or other in kept)
        }
        reserved = reserved_motion(problem, number, moment.states[number], moment.warm[number])
        made[number] = plan_one(
            number,
            discs_to_avoid(problem, moment.driven, others),
            reserved.places_m[: problem.planner.horizon + 1],
            made,
        )
    plans = [made[number] for number in range(len(order))]
    return with_separations(problem, moment.driven, plans)


@dataclass(frozen=True, eq=False)
class Member:
    """Robot of a team with its own problem, ground and planner."""

    problem: Problem  # Problem with this robot alone
    start: Floats  # (s,) initial state
    ground: Ground
    planner: Planner
    steer: Steer | None  # None if no term steers
    region: Region  # Region of the map

    def plan(
        self,
        belief: Belief,
        state: Floats,  # (s,)
        watched: Aim,
        warm: Plan | None,
        moving: MovingDiscs = NOTHING_MOVES,
        reserved_m: Floats | None = None,  # (N + 1, 2)
        history: History = BEGINNING,
        pending: Pending = NOTHING_PENDING,
    ) -> tuple[Plan, Aim]:
        """Return this robot's plan from `state`, and its objective's external inputs."""
        base = verifier_context(
            self.problem, self.ground.index, belief.posteriors, state, history, moving
        )
        context = step_context(base, self.region, replace(watched, pending=pending))
        if self.steer is not None:
            context = replace(context, steering=self.steer(context))
        scorer = Scorer(
            context,
            ObjectiveValue(context),
            reserved_m[1:] if reserved_m is not None and len(moving) else None,
        )
        plan = _valued_alone(plan_of(self.planner, context, scorer, warm), context)
        steered = None if context.steering is None else context.steering.turns_m
        return plan, replace(watched, steering_turns_m=steered, pending=pending)

    def value(self, plan: Plan, belief: Belief, aim: Aim, history: History) -> float:
        """Return the objective value of a plan's path for external inputs `aim`."""
        index, place = self.ground.index, plan.positions_m[0]
        base = verifier_context(self.problem, index, belief.posteriors, place, history)
        return ObjectiveValue(step_context(base, self.region, aim))(plan.positions_m[1:])


def _valued_alone(plan: Plan, context: StepContext) -> Plan:
    """Return the plan with its objective value recomputed in a fresh context."""
    # Beyond `SEARCH_EXACT_LIMIT` measurements, predictions depend on the positions that are
    # predicted together, so values computed during a search are not reproducible.
    if len(context.posterior.measurements) <= SEARCH_EXACT_LIMIT:
        return plan
    value = ObjectiveValue(replace(context))(plan.positions_m[1:])
    unrefined = plan.lattice_objective == plan.objective
    start = value if unrefined else plan.lattice_objective
    return replace(plan, objective=value, lattice_objective=start)


def build_team(
    problem: Problem,
    seeds: TeamSeeds,
    foreseen_m: Sequence[Floats] | None = None,  # (T, 2) of each robot
) -> tuple[Member, ...]:
    """Return the team of a problem; its robots follow the paths `foreseen_m` if supplied."""
    region = workspace_region(problem)
    team: list[Member] = []
    for number, generator in enumerate(seeds.planners):
        own = problem_of_robot(problem, number)
        start = own.robots[0].start_state
        ground = build_ground(own, start[:2], team[0].ground if team else None)
        if foreseen_m is None:
            planner = planner_for(own, ground, generator)
        else:
            planner = FollowingPlanner(foreseen_m[number])
        steerings = (
            STEERINGS[term.steers](own, ground, term).find_path
            for term in own.terms
            if term.steers is not None
        )
        team.append(Member(own, start, ground, planner, next(steerings, None), region))
    return tuple(team)


def plan_together(
    problem: Problem, team: Sequence[Member], moment: TeamMoment
) -> tuple[list[Plan], list[Aim]]:
    """Return a plan for every robot, and the external inputs of its objective."""
    order = list(range(len(team)))
    kept = {
        number: reserved_motion(problem, number, moment.states[number], moment.warm[number])
        for number in order
    }
    plans, aims = _in_order(problem, team, moment, order, kept)
    stuck = [number for number in order if plans[number].verdict is not Verdict.VERIFIED]
    if stuck and len(team) > 1 and problem.constraints.separation_m > 0.0:
        again = stuck + [number for number in order if number not in stuck]
        second, second_aims = _in_order(problem, team, moment, again, {})
        if keep_apart(problem, second) and _verified(second) > _verified(plans):
            plans, aims = second, second_aims
    if counts_others(problem) and len(team) > 1:
        for _ in range(problem.planner.rounds - 1):
            plans, aims = _again_in_turn(problem, team, moment, plans, aims)
    return plans, aims


def _in_order(
    problem: Problem,
    team: Sequence[Member],
    moment: TeamMoment,
    order: Sequence[int],
    kept: Mapping[int, TimedMotion],
) -> tuple[list[Plan], list[Aim]]:
    """Return plans and external inputs; plans made in `order` avoid all known motions."""
    aims: dict[int, Aim] = {}

    def plan_one(
        number: int, moving: MovingDiscs, reserved_m: Floats, made: Mapping[int, Plan]
    ) -> Plan:
        plan, aims[number] = _planned(team, moment, number, moving, reserved_m, made)
        return plan

    plans = plan_in_turn(problem, moment, order, kept, plan_one)
    return plans, [aims[number] for number in range(len(team))]


def _planned(
    team: Sequence[Member],
    moment: TeamMoment,
    number: int,
    moving: MovingDiscs,
    reserved_m: Floats,
    made: Mapping[int, Plan],
) -> tuple[Plan, Aim]:
    """Return one robot's plan and external inputs, given the others' planned measurements."""
    pending = NOTHING_PENDING
    if counts_others(team[number].problem):
        planned = tuple(made[other].positions_m[1:] for other in sorted(made) if other != number)
        pending = Pending(planned, places_of_others(moment.driven_m, number))
    return team[number].plan(
        moment.beliefs[number],
        moment.states[number],
        moment.watched[number],
        moment.warm[number],
        moving,
        reserved_m,
        moment.histories[number],
        pending,
    )


def _again_in_turn(
    problem: Problem,
    team: Sequence[Member],
    moment: TeamMoment,
    plans: Sequence[Plan],
    aims: Sequence[Aim],
) -> tuple[list[Plan], list[Aim]]:
    """Return plans and external inputs after each robot has planned again, the others fixed."""
    # With F the objective of all plans together, F(p_i | others) = F(all) - F(others). Only a
    # verified plan of larger F(p_i | others) replaces a verified plan, so that F(all) never
    # decreases. Robots with individual weights compare by their own objective.
    chosen = list(aims)

    def plan_one(
        number: int, moving: MovingDiscs, reserved_m: Floats, made: Mapping[int, Plan]
    ) -> Plan:
        old, known = plans[number], dict(enumerate(plans)) | dict(made)
        plan, aim = _planned(team, moment, number, moving, reserved_m, known)
        before = moment.beliefs[number], aim, moment.histories[number]
        better = plan.objective > team[number].value(old, *before)
        better |= old.verdict is not Verdict.VERIFIED
        if plan.verdict is not Verdict.VERIFIED or not better:
            return old
        chosen[number] = aim
        return plan

    kept = {number: planned_motion(problem, plan) for number, plan in enumerate(plans)}
    found = plan_in_turn(problem, moment, range(len(team)), kept, plan_one)
    return found, chosen


def keep_apart(problem: Problem, plans: Sequence[Plan]) -> bool:
    """Return whether the plans of one step satisfy the mutual separations."""
    limit = problem.constraints.separation_m - CLEARANCE_TOLERANCE_M
    found = [plan.certificate.min_separation_m for plan in plans]
    return all(distance is None or distance >= limit for distance in found)


def _verified(plans: Sequence[Plan]) -> int:
    return sum(plan.verdict is Verdict.VERIFIED for plan in plans)


STAYING = (Rung.SHIFTED, Rung.STOP, Rung.RESERVED, Rung.LEAVE)
"""Fallbacks that make no progress to a goal: the previous plan, waiting, leaving an obstacle."""
NO_LIMIT_M = -1e9  # Radius of a moving obstacle after its predicted steps, negative to disable it


class Couriers:
    """Planner for all robots of a problem with goals; it stores the order of their courses."""

    def __init__(self, problem: Problem, scenes: Sequence[Scene], seeds: TeamSeeds) -> None:
        count = len(problem.robots)
        others = count - 1 if problem.has_separation else 0
        self._problem = problem
        self._planners: list[ReachPlanner] = []
        for number, (scene, generator) in enumerate(zip(scenes, seeds.planners, strict=True)):
            own, proposal = problem_of_robot(problem, number), None
            if problem.planner.name not in OWN:
                proposal = partial(plan_of, planner_for(own, scene, generator))
            self._planners.append(ReachPlanner(own, scene, others, proposal))
        self._order = list(range(count))
        self._arrived: list[int] = []

    def plan(self, at: TeamMoment) -> list[Plan]:
        """Return a plan for every robot."""
        robots = zip(self._planners, at.beliefs, at.states, at.histories, strict=True)
        outlooks = [
            planner.outlook(belief, state, history) for planner, belief, state, history in robots
        ]
        if not self._problem.has_separation:
            return [
                planner.release(outlook, warm)
                for planner, outlook, warm in zip(self._planners, outlooks, at.warm, strict=True)
            ]
        courses = self._courses(at, outlooks)
        reserved = {
            number: reserved_motion(self._problem, number, state, warm)
            for number, (state, warm) in enumerate(zip(at.states, at.warm, strict=True))
        }
        if courses is None:
            return self._in_turn(at, outlooks, reserved)
        planned = [course.outlook for course in courses]
        horizon = self._problem.planner.horizon
        # The part of each course within the horizon, if it can be driven.
        first = {
            number: TimedMotion(course.places_m[: horizon + 1])
            for number, course in enumerate(courses)
            if self._problem.robots[number].moves_freely and course.outlook.start is not None
        }
        plans = self._in_turn(at, planned, reserved | first)
        verified = all(plan.verdict is Verdict.VERIFIED for plan in plans)
        if verified and keep_apart(self._problem, plans):
            return plans
        instead = self._in_turn(at, outlooks, reserved)
        # True if a robot that has not arrived has wandered or waited too long.
        must_move = any(
            outlook.start is not None
            and outlook.start.is_direct
            and not is_at_goal(planner.problem, state[:2])
            for planner, outlook, state in zip(self._planners, outlooks, at.states, strict=True)
        )
        return max((plans, instead), key=lambda made: self._rank(made, must_move))

    def _rank(self, plans: Sequence[Plan], must_move: bool) -> tuple[bool, int, int]:
        """Return the rank of plans by separation, motion (if required) and verification."""
        # Otherwise two robots could block each other: waiting is verified, giving way may not be.
        leading = sum(plan.rung not in STAYING for plan in plans) if must_move else 0
        verified = sum(plan.verdict is Verdict.VERIFIED for plan in plans)
        return keep_apart(self._problem, plans), leading, verified

    def _in_turn(
        self, at: TeamMoment, outlooks: Sequence[Outlook], kept: Mapping[int, TimedMotion]
    ) -> list[Plan]:
        """Return plans made in sequence that avoid earlier plans and reserved motions."""

        def plan_one(
            number: int, moving: MovingDiscs, reserved_m: Floats, _: Mapping[int, Plan]
        ) -> Plan:
            planner, warm = self._planners[number], at.warm[number]
            return planner.release(outlooks[number], warm, moving, reserved_m[1:])

        return plan_in_turn(self._problem, at, self._order, kept, plan_one)

    def _courses(self, at: TeamMoment, outlooks: Sequence[Outlook]) -> list[Course] | None:
        """Return separated courses and store their order; None if none are found."""
        # If no order lets all arrive, some wait at refuges off the others' paths; robots that have
        # been at their goals plan last. If waiting robots block the way, all others make room for
        # the first robot that has not arrived.
        for number, state in enumerate(at.states):
            at_goal = is_at_goal(self._planners[number].problem, state[:2])
            if at_goal and number not in self._arrived:
                self._arrived.append(number)
        alone = self._alone(outlooks)
        order: list[int] = sorted(self._order, key=lambda number: number in self._arrived)
        searched: list[list[int]] = []
        waiting: list[Course] = []
        while order not in searched:
            searched.append(order)
            found, late = self._in_order(at, order, alone)
            if late is None:
                self._order = order
                return [found[number] for number in range(len(order))]
            if len(found) == len(order) and not waiting:
                self._order = order
                waiting = [found[number] for number in range(len(order))]
            order = [late, *[other for other in order if other != late]]
        going = [number for number in self._order if number not in self._arrived]
        if waiting and (not going or waiting[going[0]].arrives):
            return waiting
        return (self._with_room(at, going[0], alone) if going else None) or waiting or None

    def _with_room(
        self, at: TeamMoment, first: int, alone: Sequence[Course]
    ) -> list[Course] | None:
        """Return courses on which all other robots make room for robot `first`, or None."""
        passing = alone[first].places_m
        steps = len(passing) - 1
        found: dict[int, Course] = {}
        for number in self._order:
            if number == first:
                continue
            course = self._planners[number].refuge_course(alone[number].outlook, passing, steps)
            if course is None:
                return None
            if is_apart(_discs(self._problem, found, steps), course.places_m):
                found[number] = course
        for number in (first, *self._order):
            if number not in found:
                course = self._course(at, number, alone[number], found)
                if course is None or (number == first and not course.arrives):
                    return None
                found[number] = course
        return [found[number] for number in range(len(alone))]

    def _in_order(
        self, at: TeamMoment, order: Sequence[int], alone: Sequence[Course]
    ) -> tuple[dict[int, Course], int | None]:
        """Return the courses found in `order`, and the first robot not to arrive (or None)."""
        found: dict[int, Course] = {}
        late: int | None = None
        for number in order:
            course = self._course(at, number, alone[number], found)
            late = number if late is None and (course is None or not course.arrives) else late
            if course is None:
                break
            found[number] = course
        return found, late

    def _alone(self, outlooks: Sequence[Outlook]) -> list[Course]:
        """Return each robot's course without regard to the others, over equally many steps."""
        horizon = self._problem.planner.horizon
        paths: list[tuple[Floats, Floats]] = []
        for outlook in outlooks:
            start, here = outlook.start, outlook.state[None, :2]
            path = np.tile(here, (horizon, 1)) if start is None else start.path_m
            paths.append((np.vstack([here, path]), here if start is None else start.route_m))
        longest = [planner.problem.step_length_m - STEP_PAD_M for planner in self._planners]
        lengths = [
            np.linalg.norm(np.diff(np.vstack([path[-1:], route]), axis=0), axis=1).sum()
            for path, route in paths
        ]
        steps = max(int(m / step_m) for m, step_m in zip(lengths, longest, strict=True))
        steps += horizon + 2 + DELAYS_STEPS[-1]
        return [
            Course(outlook, timed_places(*path, step_m, steps))
            for outlook, path, step_m in zip(outlooks, paths, longest, strict=True)
        ]

    def _course(
        self, at: TeamMoment, number: int, alone: Course, found: Mapping[int, Course]
    ) -> Course | None:
        """Return a robot's course that avoids the courses in `found`; None if there is none."""
        robots = _discs(self._problem, found, len(alone.places_m) - 1)
        if alone.outlook.start is None or is_apart(robots, alone.places_m):
            return alone
        obstacles = obstacles_ahead(self._problem, at.driven)
        discs = joined_discs(robots, _lasting(obstacles, robots.steps))
        return self._planners[number].clear_course(alone.outlook, discs)


def _discs(problem: Problem, courses: Mapping[int, Course], steps: int) -> MovingDiscs:
    """Return moving discs that represent robots on their courses."""
    count = len(courses)
    return MovingDiscs(
        tuple(problem.robots[number].name for number in courses),
        np.reshape([course.places_m for course in courses.values()], (count, steps + 1, 2)),
        np.zeros((count, steps)),
        np.full(count, problem.constraints.separation_m),
        np.ones(count, dtype=np.bool_),
    )


def _lasting(discs: MovingDiscs, steps: int) -> MovingDiscs:
    """Return the discs extended to `steps` steps, disabled in the added steps."""
    more = steps - discs.steps
    if not len(discs) or more <= 0:
        return discs
    centres = np.repeat(discs.centres_m[:, -1:], more, axis=1)
    return MovingDiscs(
        discs.names,
        np.concatenate([discs.centres_m, centres], axis=1),
        np.pad(discs.radius_m, ((0, 0), (0, more)), constant_values=NO_LIMIT_M),
        discs.least_m,
        discs.is_robot,
    )


def planning(
    problem: Problem,
    scenes: Sequence[Scene] | None,
    seeds: TeamSeeds,
    foreseen_m: Sequence[Floats] | None = None,  # (T, 2)
) -> Planning:
    """Return a function that creates the step planner of a team, for goals or a sum of terms."""
    # The scenes belong to the initial obstacles and are rebuilt if obstacles change.

    def made(now: Problem, states: Sequence[Floats]) -> PlanStep:
        at_start = now.workspace.obstacles == problem.workspace.obstacles
        places = [state[:2] for state in states]
        known = scenes if at_start else build_scenes(now, places)
        if known is not None:
            couriers = Couriers(now, known, seeds)
            return lambda at: (couriers.plan(at), [Aim() for _ in now.robots])
        team = build_team(now, seeds, foreseen_m)
        return lambda at: plan_together(now, team, at)

    return made
