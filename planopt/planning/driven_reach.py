"""The way to a goal of a robot that cannot turn or stop at will: starts, pivot, and the ladder.

The search finds a way of a robot that can. This one follows it, and what lies ahead is counted from
where it would come to stand: there the pivot is looked for, and from there the solver is drawn to
it. A robot that can stop at the goal brakes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.planning.arrival import stops_at_goal
from planopt.planning.budget import Budget
from planopt.planning.candidate import Candidate
from planopt.planning.driven import (
    drive_candidate,
    driven_start,
    dynamics_of,
    last_drive,
    without_start,
)
from planopt.planning.ground import first_moves
from planopt.planning.judge import Judge
from planopt.planning.ladder import Ladder
from planopt.planning.plan import Pivot, Plan, Rung, Termination, Verdict
from planopt.planning.programme.goal_cost import ROUNDING_STEPS, GoalCharge
from planopt.planning.programme.methods import METHODS
from planopt.planning.programme.pivot import find_pivot
from planopt.planning.scene import Scene
from planopt.planning.search.global_search import GlobalStart
from planopt.planning.search.retime import retime
from planopt.planning.tolerances import STEP_PAD_M
from planopt.planning.worth.reach_cost import ReachCost, resting_places_m
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive, rolled_out

FOLLOWED_HORIZONS = 2
"""So much of the way is followed, that a robot does not brake where its horizon ends."""

GAIN_SHARE = 0.15
"""What a polish may gain on the way that is followed, as a share of the longest."""


class DrivenReach:
    """Plans of one problem; keeps the ladder's solvers.

    Parameters
    ----------
    problem
        That is to reach a goal.
    scene
        Its geometry.
    """

    def __init__(self, problem: Problem, scene: Scene) -> None:
        self._problem = problem
        self._scene = scene
        self._ladder = Ladder(problem, scene.ground)

    def chosen(
        self,
        situation: Situation,
        judge: Judge,
        start: GlobalStart | None,
        node_margin_db: NDArray[np.float64] | None,
        warm: Plan | None,
        budget: Budget,
    ) -> tuple[Candidate, Pivot | None]:
        """What is released, and the pivot that it is charged by.

        Parameters
        ----------
        situation, judge
            Of the step.
        start
            What the search found, for a robot that turns and stops at will; None if nothing.
        node_margin_db
            As :func:`planopt.planning.programme.pivot.find_pivot` takes them.
        warm
            The plan that led here, or None.
        budget
            Of the step.
        """
        if start is None:
            return without_start(judge, warm), None
        problem = self._problem
        drives = self._drives(judge, start, warm)
        node, place = min(
            (self._end(start, drive) for drive in drives),
            key=lambda end: float(start.ways.cost_m[end[0]]),
        )
        pivot = find_pivot(
            self._scene,
            replace(start, nodes=np.append(start.nodes[:-1], node)),
            node_margin_db,
            problem.step_length_m,
            problem.constraints.clearance_m,
            place,
        )
        cost = ReachCost(problem, judge.position_m, pivot)
        judge = replace(
            judge,
            objective=cost,
            objective_of_drive=lambda drive: cost(drive.positions_m[1:], drive),
        )
        stopped = _stopped(judge) if stops_at_goal(problem, judge.state) else None
        if stopped is not None:
            return stopped, pivot
        starts = [
            replace(driven_start(judge, situation, drive), charge=self._charge(cost, pivot, drive))
            for drive in drives
        ]
        starts.sort(key=lambda each: (not each.clear, round(each.missing_db, 2), -each.worth))
        return self._ladder.climb(situation, judge, starts, warm, budget), pivot

    def _drives(self, judge: Judge, start: GlobalStart, warm: Plan | None) -> list[Drive]:
        """Ways that the robot can drive: along what was found, and the last plan."""
        problem = self._problem
        dynamics, step_s = dynamics_of(problem), problem.planner.step_s
        horizon = problem.planner.horizon
        way = np.vstack([start.path_m, start.beyond_m])
        way = np.vstack([way, np.tile(way[-1], (FOLLOWED_HORIZONS * horizon, 1))])
        way = retime(judge.position_m, way, way[:0], problem.step_length_m - STEP_PAD_M)
        ahead = dynamics.following(judge.state, way[: FOLLOWED_HORIZONS * horizon], step_s)
        followed = rolled_out(dynamics, judge.state, ahead[:horizon], step_s)
        last = last_drive(problem, warm)
        return [followed] if last is None else [followed, last]

    def _end(self, start: GlobalStart, drive: Drive) -> tuple[int, NDArray[np.float64]]:
        """Where a drive would come to stand (2,), and the node by which the way goes on from it."""
        ways, scene = start.ways, self._scene
        for place in (resting_places_m(drive)[-1], drive.positions_m[-1]):
            nodes, lengths = first_moves(scene.ground, self._problem, place)
            if len(nodes):
                best = int(np.argmin(lengths + ways.cost_m[nodes]))
                return int(nodes[best]), place
        return int(start.nodes[-1]), start.path_m[-1]

    def _charge(self, cost: ReachCost, pivot: Pivot, drive: Drive) -> GoalCharge:
        """What a polish from a drive is charged; by each step where it may come to the pivot."""
        problem, horizon = self._problem, len(drive.inputs)
        away = np.linalg.norm(resting_places_m(drive)[1:] - pivot.position_m, axis=1)
        arrived = np.flatnonzero(away <= problem.constraints.goal_radius_m)
        near = GAIN_SHARE * horizon * problem.step_length_m
        steps = int(arrived[0]) + 1 if len(arrived) else horizon
        ends = pivot.cost_m == 0.0 and (len(arrived) > 0 or bool(away[-1] <= near))
        return GoalCharge(
            pivot.position_m,
            problem.reach.effort_weight_s2_m2 / problem.planner.step_s,
            cost.rate_s_m,
            1.0 / steps if ends else 0.0,
            ROUNDING_STEPS * problem.step_length_m,
        )


def _stopped(judge: Judge) -> Candidate | None:
    """Brake at the goal; None where that is not verified."""
    dynamics, planner = dynamics_of(judge.problem), judge.problem.planner
    braking = dynamics.braking(judge.state, planner.step_s, planner.horizon)
    drive = rolled_out(dynamics, judge.state, braking, planner.step_s)
    rung = Rung.LATTICE if planner.name in METHODS else Rung.PLAN
    found = judge.judged(drive_candidate(judge, drive, rung, Termination.LATTICE_ONLY))
    return found if found.verdict is Verdict.VERIFIED else None
