"""The robots of a problem whose objective is a sum of terms, each ready to plan for itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.objectives.mapping import Region
from planopt.objectives.terms.term import Steers
from planopt.planning.baselines.foresight import FollowingPlanner
from planopt.planning.ground import Ground, build_ground
from planopt.planning.history import BEGINNING, History
from planopt.planning.judge import Judge
from planopt.planning.plan import Plan
from planopt.planning.planners import Planner, planner_for
from planopt.planning.proof.circumstances import circumstances_of
from planopt.planning.proof.predictions import SEARCH_EXACT_LIMIT
from planopt.planning.robot_problem import problem_of_robot
from planopt.planning.team.team_seeds import TeamSeeds
from planopt.planning.worth.aim import Aim
from planopt.planning.worth.connection_steering import ConnectionSteering
from planopt.planning.worth.goal_steering import GoalSteering
from planopt.planning.worth.path_worth import PathWorth
from planopt.planning.worth.pending import NOTHING_PENDING, Pending
from planopt.planning.worth.region import workspace_region
from planopt.planning.worth.situation import Situation
from planopt.planning.worth.steering import Steering
from planopt.planning.worth.steering_way import SteeringWay, steering_way
from planopt.problems.problem import Problem
from planopt.world.moving_discs import NOTHING_MOVES, MovingDiscs

Steer = Callable[[Situation], SteeringWay | None]

STEERINGS: Mapping[Steers, Callable[[Problem, Ground, Any], Any]] = {
    "variance": Steering,
    "connection": ConnectionSteering,
    "goal": GoalSteering,
}
"""What finds the way, by what a term steers to; made of problem, ground and term."""


@dataclass(frozen=True, eq=False)
class Member:
    """One robot: its own problem, ground and planner, and what finds where to steer to.

    Attributes
    ----------
    problem
        With this robot alone.
    start
        ``(s,)`` its state at the start; of a single integrator its place.
    ground
        Its geometry.
    planner
        The one that the problem names.
    steer
        From what is known to the way to steer along; None where no term steers.
    region
        Where the map is wanted.
    """

    problem: Problem
    start: NDArray[np.float64]
    ground: Ground
    planner: Planner
    steer: Steer | None
    region: Region

    def plan(
        self,
        belief: Belief,
        state: NDArray[np.float64],
        watched: Aim,
        warm: Plan | None,
        moving: MovingDiscs = NOTHING_MOVES,
        reserved_m: NDArray[np.float64] | None = None,
        history: History = BEGINNING,
        pending: Pending = NOTHING_PENDING,
    ) -> tuple[Plan, Aim]:
        """Plan from `state` (s,) on what this robot believes.

        Parameters
        ----------
        belief
            Of the channel.
        state
            Of the robot, its place first.
        watched
            What is known of the target.
        warm
            The plan that led here, or None.
        moving
            What it must keep from.
        reserved_m
            ``(N + 1, 2)`` what the others keep clear of for it; None where nothing moves.
        history
            What has happened on the run before.
        pending
            Where the others measure; counted where a term does.
        """
        position_m = state[:2]
        circumstances = circumstances_of(self.problem, belief.posteriors, history, moving)
        situation = Situation(
            self.problem,
            belief.posterior,
            position_m,
            watched.target_m,
            self.region,
            information=watched.information,
            circumstances=circumstances,
            pending=pending,
        )
        if self.steer is not None:
            situation = replace(situation, steering=self.steer(situation))
        judge = Judge(
            self.problem,
            self.ground.index,
            belief,
            position_m,
            PathWorth(situation),
            circumstances,
            reserved_m[1:] if reserved_m is not None and len(moving) else None,
            state[2:],
        )
        plan = _valued_alone(self.planner.plan(situation, judge, warm), situation)
        steered = None if situation.steering is None else situation.steering.turns_m
        return plan, replace(watched, steering_turns_m=steered, pending=pending)

    def worth(self, plan: Plan, belief: Belief, aim: Aim, history: History) -> float:
        """Return what the path of a plan is worth for an aim, on what this robot believes."""
        steering = None
        if aim.steering_turns_m is not None:
            steering = steering_way(self.problem, self.ground.index, aim.steering_turns_m)
        situation = Situation(
            self.problem,
            belief.posterior,
            plan.positions_m[0],
            aim.target_m,
            self.region,
            steering,
            aim.information,
            circumstances_of(self.problem, belief.posteriors, history),
            aim.pending,
        )
        return PathWorth(situation)(plan.positions_m[1:])


def _valued_alone(plan: Plan, situation: Situation) -> Plan:
    """The plan with the worth that its path has for who looks at it alone.

    Beyond `SEARCH_EXACT_LIMIT` measurements, places are predicted in groups, and those of a search
    are others than the path's own.
    """
    if len(situation.posterior.measurements) <= SEARCH_EXACT_LIMIT:
        return plan
    worth = PathWorth(replace(situation))(plan.positions_m[1:])
    unpolished = plan.lattice_objective == plan.objective
    start = worth if unpolished else plan.lattice_objective
    return replace(plan, objective=worth, lattice_objective=start)


def build_crew(
    problem: Problem, seeds: TeamSeeds, foreseen_m: Sequence[NDArray[np.float64]] | None = None
) -> tuple[Member, ...]:
    """Every robot of `problem`, in its order; planners that draw use the streams of `seeds`.

    With `foreseen_m`, a path (T, 2) for each, they follow these.

    Raises
    ------
    InputError
        The problem names a planner that does not plan its terms.
    """
    region = workspace_region(problem)
    crew: list[Member] = []
    for number, generator in enumerate(seeds.planners):
        beside = crew[0].ground if crew else None
        crew.append(_member(problem, number, region, generator, foreseen_m, beside))
    return tuple(crew)


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
    """What steers the robot of a problem; None where no term does."""
    for term in problem.terms:
        if term.steers is not None:
            return STEERINGS[term.steers](problem, ground, term).find_way
    return None
