"""The robots of a problem whose objective is a sum of terms, and one step of all of them.

In the first round each robot keeps from what the later ones have reserved
(:mod:`planopt.planning.reservations`), so that everyone has a way out. If a robot finds no
verified plan that way, because the others leave it none, a second round asks it first, and each
robot keeps from the plans made before it only: the others make room if they can. The result is
released only if all plans keep apart from each other and more of them are verified.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.objectives.moments import Region
from planopt.objectives.terms.term import Steers
from planopt.planning.candidates import Judge
from planopt.planning.foresight import FollowingPlanner
from planopt.planning.history import BEGINNING, History
from planopt.planning.initial_data import TeamSeeds
from planopt.planning.plan import Plan, Verdict
from planopt.planning.planners import Planner, asked_plan, planner_for
from planopt.planning.proof.context import SEARCH_EXACT_LIMIT, verifier_context
from planopt.planning.reservations import (
    beside,
    beside_each_other,
    planned_motion,
    reserved_motion,
)
from planopt.planning.scene import Ground, build_ground
from planopt.planning.stepping import TeamMoment
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.planning.values.context import (
    NOTHING_PENDING,
    Aim,
    Pending,
    StepContext,
    counts_others,
    places_of_others,
    step_context,
)
from planopt.planning.values.exploration import workspace_region
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.planning.values.steered_path import SteeringWay, steering_way
from planopt.planning.values.steering import ConnectionSteering, GoalSteering, Steering
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.moving_discs import NOTHING_MOVES, MovingDiscs

Steer = Callable[[StepContext], SteeringWay | None]

STEERINGS: Mapping[Steers, Callable[[Problem, Ground, Any], Any]] = {
    "variance": Steering,
    "connection": ConnectionSteering,
    "goal": GoalSteering,
}
"""What finds the way, by what a term steers to; made of problem, ground and term."""


@dataclass(frozen=True, eq=False)
class Member:
    """One robot: its own problem, ground and planner, and what finds where to steer to."""

    problem: Problem  # With this robot alone
    start: NDArray[np.float64]  # (s,) its state at the start; of a single integrator its place
    ground: Ground  # Its geometry
    planner: Planner  # The one that the problem names
    steer: Steer | None  # From what is known to the way to steer along; None where no term steers
    region: Region  # Where the map is wanted

    def plan(
        self,
        belief: Belief,
        state: NDArray[np.float64],
        watched: Aim,
        warm: Plan | None,
        moving: MovingDiscs = NOTHING_MOVES,
        reserved_m: NDArray[np.float64] | None = None,  # (N + 1, 2)
        history: History = BEGINNING,
        pending: Pending = NOTHING_PENDING,
    ) -> tuple[Plan, Aim]:
        """Plan from `state` (s,) on what this robot believes."""
        base = verifier_context(
            self.problem, self.ground.index, belief.posteriors, state, history, moving
        )
        situation = step_context(base, self.region, replace(watched, pending=pending))
        if self.steer is not None:
            situation = replace(situation, steering=self.steer(situation))
        judge = Judge(
            situation,
            ObjectiveValue(situation),
            reserved_m[1:] if reserved_m is not None and len(moving) else None,
        )
        plan = _valued_alone(asked_plan(self.planner, situation, judge, warm), situation)
        steered = None if situation.steering is None else situation.steering.turns_m
        return plan, replace(watched, steering_turns_m=steered, pending=pending)

    def worth(self, plan: Plan, belief: Belief, aim: Aim, history: History) -> float:
        """Return what the path of a plan is worth for an aim, on what this robot believes."""
        index, place = self.ground.index, plan.positions_m[0]
        base = verifier_context(self.problem, index, belief.posteriors, place, history)
        situation = step_context(base, self.region, aim)
        if aim.steering_turns_m is not None:
            steering = steering_way(self.problem, index, aim.steering_turns_m)
            situation = replace(situation, steering=steering)
        return ObjectiveValue(situation)(plan.positions_m[1:])


def _valued_alone(plan: Plan, situation: StepContext) -> Plan:
    """The plan with the worth that its path has for who looks at it alone.

    Beyond `SEARCH_EXACT_LIMIT` measurements, places are predicted in groups, and those of a search
    are others than the path's own.
    """
    if len(situation.posterior.measurements) <= SEARCH_EXACT_LIMIT:
        return plan
    worth = ObjectiveValue(replace(situation))(plan.positions_m[1:])
    unrefined = plan.lattice_objective == plan.objective
    start = worth if unrefined else plan.lattice_objective
    return replace(plan, objective=worth, lattice_objective=start)


def build_team(
    problem: Problem, seeds: TeamSeeds, foreseen_m: Sequence[NDArray[np.float64]] | None = None
) -> tuple[Member, ...]:
    """Every robot of `problem`, in its order; planners that draw use the streams of `seeds`.

    With `foreseen_m`, a path (T, 2) for each, they follow these.
    """
    region = workspace_region(problem)
    team: list[Member] = []
    for number, generator in enumerate(seeds.planners):
        beside = team[0].ground if team else None
        team.append(_member(problem, number, region, generator, foreseen_m, beside))
    return tuple(team)


def _member(
    problem: Problem,
    number: int,
    region: Region,
    generator: np.random.Generator,
    foreseen_m: Sequence[NDArray[np.float64]] | None,
    beside: Ground | None,
) -> Member:
    own = problem_of_robot(problem, number)
    start = own.robots[0].start_state
    ground = build_ground(own, start[:2], beside)
    if foreseen_m is None:
        planner = planner_for(own, ground, generator)
    else:
        planner = FollowingPlanner(foreseen_m[number])
    return Member(own, start, ground, planner, _steer(own, ground), region)


def _steer(problem: Problem, ground: Ground) -> Steer | None:
    """Return the steering of a problem's robot; None where no term steers."""
    for term in problem.terms:
        if term.steers is not None:
            return STEERINGS[term.steers](problem, ground, term).find_way
    return None


def plan_together(
    problem: Problem, team: Sequence[Member], moment: TeamMoment
) -> tuple[list[Plan], list[Aim]]:
    """A plan for every robot, and what it was made for."""
    order = list(range(len(team)))
    plans, aims = _in_order(problem, team, moment, order, keep_reserved=True)
    stuck = [number for number in order if plans[number].verdict is not Verdict.VERIFIED]
    if stuck and len(team) > 1 and problem.constraints.separation_m > 0.0:
        again = stuck + [number for number in order if number not in stuck]
        tried, tried_aims = _in_order(problem, team, moment, again, keep_reserved=False)
        if keep_apart(problem, tried) and _verified(tried) > _verified(plans):
            plans, aims = tried, tried_aims
    if counts_others(problem) and len(team) > 1:
        for _ in range(problem.planner.rounds - 1):
            plans, aims = _again_in_turn(problem, team, moment, plans, aims)
    return plans, aims


def _in_order(
    problem: Problem,
    team: Sequence[Member],
    moment: TeamMoment,
    order: Sequence[int],
    *,
    keep_reserved: bool,
) -> tuple[list[Plan], list[Aim]]:
    """Let robots plan in this order, each beside the plans made, and what is reserved if asked."""
    reserved = [
        reserved_motion(problem, number, state, plan)
        for number, (state, plan) in enumerate(zip(moment.states, moment.warm, strict=True))
    ]
    made: dict[int, tuple[Plan, Aim]] = {}
    for number in order:
        others = {
            other: planned_motion(problem, made[other][0]) if other in made else reserved[other]
            for other in range(len(team))
            if other != number and (keep_reserved or other in made)
        }
        made[number] = team[number].plan(
            moment.beliefs[number],
            moment.states[number],
            moment.watched[number],
            moment.warm[number],
            beside(problem, moment.driven, others),
            reserved[number].places_m[: problem.planner.horizon + 1],
            moment.histories[number],
            _pending(team, moment, number, {other: made[other][0] for other in made}),
        )
    plans = [made[number][0] for number in range(len(team))]
    aims = [made[number][1] for number in range(len(team))]
    return beside_each_other(problem, moment.driven, plans), aims


def _pending(
    team: Sequence[Member], moment: TeamMoment, number: int, made: Mapping[int, Plan]
) -> Pending:
    """Return where others measure, as robot `number` is told: by plans `made`, and before."""
    if not counts_others(team[number].problem):
        return NOTHING_PENDING
    planned = tuple(made[other].positions_m[1:] for other in sorted(made) if other != number)
    return Pending(planned, places_of_others(moment.driven_m, number))


def _again_in_turn(
    problem: Problem,
    team: Sequence[Member],
    moment: TeamMoment,
    plans: Sequence[Plan],
    aims: Sequence[Aim],
) -> tuple[list[Plan], list[Aim]]:
    """One more round: each robot plans beside all plans of the others, and keeps the better plan.

    With F the worth of all plans together, F(p_i | others) = F(all) - F(others). A plan is
    exchanged only for a verified one, and a verified one only for one of larger F(p_i | others), so
    that F(all) never falls among verified plans. Robots that weigh terms differently have no
    common F: each then exchanges its plan for one that is better by its own weights.
    """
    plans, aims = list(plans), list(aims)
    for number, member in enumerate(team):
        others = {n: planned_motion(problem, p) for n, p in enumerate(plans) if n != number}
        moving = beside(problem, moment.driven, others)
        pending = _pending(team, moment, number, dict(enumerate(plans)))
        reserved = reserved_motion(problem, number, moment.states[number], moment.warm[number])
        plan, aim = member.plan(
            moment.beliefs[number],
            moment.states[number],
            moment.watched[number],
            moment.warm[number],
            moving,
            reserved.places_m[: problem.planner.horizon + 1],
            moment.histories[number],
            pending,
        )
        before = moment.beliefs[number], aim, moment.histories[number]
        old = member.worth(plans[number], *before)
        better = plan.objective > old or plans[number].verdict is not Verdict.VERIFIED
        if plan.verdict is Verdict.VERIFIED and better:
            plans[number], aims[number] = plan, aim
    return beside_each_other(problem, moment.driven, plans), aims


def keep_apart(problem: Problem, plans: Sequence[Plan]) -> bool:
    """Return whether the plans of one step keep the separation from each other."""
    limit = problem.constraints.separation_m - CLEARANCE_TOLERANCE_M
    found = [plan.certificate.min_separation_m for plan in plans]
    return all(distance is None or distance >= limit for distance in found)


def _verified(plans: Sequence[Plan]) -> int:
    return sum(plan.verdict is Verdict.VERIFIED for plan in plans)
