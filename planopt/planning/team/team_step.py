"""One step of all robots whose objective is a sum of terms.

In the first round, each robot avoids the reservations of later robots. If a robot then has no
verified plan, it plans first in a second round that considers only completed plans.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from planopt.arrays import Floats
from planopt.channel.posterior import Belief
from planopt.objectives.moments import Region
from planopt.objectives.terms.context import NOTHING_PENDING, Aim, Pending, SteeringPath
from planopt.objectives.terms.term import Steers
from planopt.planning.candidates import Scorer
from planopt.planning.foresight import FollowingPlanner
from planopt.planning.initial_data import TeamSeeds
from planopt.planning.plan import BEGINNING, History, Plan, Verdict
from planopt.planning.planners import Planner, plan_of, planner_for
from planopt.planning.proof.context import SEARCH_EXACT_LIMIT, verifier_context
from planopt.planning.reservations import (
    discs_to_avoid,
    planned_motion,
    reserved_motion,
    with_separations,
)
from planopt.planning.scene import Ground, build_ground
from planopt.planning.search.steering import ConnectionSteering, GoalSteering, Steering
from planopt.planning.stepping import TeamMoment
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.planning.values.context import (
    StepContext,
    counts_others,
    places_of_others,
    step_context,
)
from planopt.planning.values.exploration import workspace_region
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.motion import TimedMotion
from planopt.world.moving_discs import NOTHING_MOVES, MovingDiscs

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
    """Return plans, made in `order`, that avoid all known motions, and external inputs."""
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
    """Return one robot's plan, given the others' planned measurements, and its external inputs."""
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
    """Return the plans after each robot has planned again with the other plans fixed."""
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
