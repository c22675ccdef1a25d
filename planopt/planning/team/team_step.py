"""One step of all robots: they plan one after the other, and once more where one is stuck.

In the first round each robot keeps from what the later ones have reserved
(:mod:`planopt.planning.team.reservations`), so that everyone has a way out. Where a robot finds no
verified plan that way, because the others leave it none, a second round asks it first, and each
robot keeps from the plans made before it only: the others make room if they can. What comes of that
is released only if all plans keep apart from each other and more of them are verified.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.planning.history import History
from planopt.planning.plan import Plan, Verdict
from planopt.planning.team.crew import Member
from planopt.planning.team.reservations import (
    beside,
    beside_each_other,
    planned_motion,
    reserved_motion,
)
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.planning.worth.aim import Aim
from planopt.planning.worth.pending import NOTHING_PENDING, Pending, counts_others, places_of_others
from planopt.problems.problem import Problem


@dataclass(frozen=True, eq=False)
class TeamMoment:
    """Where all robots are, and what they know.

    Attributes
    ----------
    beliefs, states, watched, histories, warm
        Of each robot: what it believes of the channel, its state (s,), what it knows of the target,
        what has happened on the run before, and the plan that led here or None.
    driven_m
        ``(k, 2)`` of each robot: where it has been after each step of the run so far; none at all
        before the first step.
    """

    beliefs: Sequence[Belief]
    states: Sequence[NDArray[np.float64]]
    watched: Sequence[Aim]
    histories: Sequence[History]
    warm: Sequence[Plan | None]
    driven_m: Sequence[NDArray[np.float64]] = ()

    @property
    def driven(self) -> int:
        """Steps of the run before this one."""
        return self.histories[0].steps


def plan_together(
    problem: Problem, crew: Sequence[Member], moment: TeamMoment
) -> tuple[list[Plan], list[Aim]]:
    """A plan for every robot, and what it was made for.

    Parameters
    ----------
    problem
        With all robots.
    crew
        All of them.
    moment
        Where they are, and what they know.
    """
    order = list(range(len(crew)))
    plans, aims = _in_order(problem, crew, moment, order, keep_reserved=True)
    stuck = [number for number in order if plans[number].verdict is not Verdict.VERIFIED]
    if stuck and len(crew) > 1 and problem.constraints.separation_m > 0.0:
        again = stuck + [number for number in order if number not in stuck]
        tried, tried_aims = _in_order(problem, crew, moment, again, keep_reserved=False)
        if keep_apart(problem, tried) and _verified(tried) > _verified(plans):
            plans, aims = tried, tried_aims
    if counts_others(problem) and len(crew) > 1:
        for _ in range(problem.planner.rounds - 1):
            plans, aims = _again_in_turn(problem, crew, moment, plans, aims)
    return plans, aims


def _in_order(
    problem: Problem,
    crew: Sequence[Member],
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
            for other in range(len(crew))
            if other != number and (keep_reserved or other in made)
        }
        made[number] = crew[number].plan(
            moment.beliefs[number],
            moment.states[number],
            moment.watched[number],
            moment.warm[number],
            beside(problem, moment.driven, others),
            reserved[number].places_m[: problem.planner.horizon + 1],
            moment.histories[number],
            _pending(crew, moment, number, {other: made[other][0] for other in made}),
        )
    plans = [made[number][0] for number in range(len(crew))]
    aims = [made[number][1] for number in range(len(crew))]
    return beside_each_other(problem, moment.driven, plans), aims


def _pending(
    crew: Sequence[Member], moment: TeamMoment, number: int, made: Mapping[int, Plan]
) -> Pending:
    """What robot `number` is told of where the others measure: by the plans `made`, and before."""
    if not counts_others(crew[number].problem):
        return NOTHING_PENDING
    planned = tuple(made[other].positions_m[1:] for other in sorted(made) if other != number)
    return Pending(planned, places_of_others(moment.driven_m, number))


def _again_in_turn(
    problem: Problem,
    crew: Sequence[Member],
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
    for number, member in enumerate(crew):
        others = {n: planned_motion(problem, p) for n, p in enumerate(plans) if n != number}
        moving = beside(problem, moment.driven, others)
        pending = _pending(crew, moment, number, dict(enumerate(plans)))
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
