"""The way to a goal of a robot that cannot turn or stop at will: initial guesses, pivot, fallbacks.

The search finds a way of a robot that can. This one follows it, and what lies ahead is counted from
where it would come to stand: from there the pivot must be seen, and from there the solver is drawn
to it. A robot that can stop at the goal brakes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.planning.budget import Budget
from planopt.planning.driven import driven_start, last_drive
from planopt.planning.fallbacks import braked, drive_candidate, without_guess
from planopt.planning.horizon_planner import FallbackCascade
from planopt.planning.judge import Candidate, Judge
from planopt.planning.plan import Pivot, Plan, Rung, Termination, Verdict, shifted_drive
from planopt.planning.programme.goal_value import ROUNDING_STEPS, GoalCharge
from planopt.planning.programme.path_nlp import METHODS
from planopt.planning.programme.pivot import Ahead, find_pivot
from planopt.planning.proof.motion import stands, stops_at_goal
from planopt.planning.scene import Scene, first_moves
from planopt.planning.search.global_search import GlobalStart
from planopt.planning.search.start_search import Start
from planopt.planning.search.taut_way import retime
from planopt.planning.tolerances import STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.planning.values.reach_cost import ReachCost, resting_places_m
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive, rolled_out

FOLLOWED_HORIZONS = (2.0, 0.5, 0.25)
"""So much of the way is followed: more than the horizon, that the robot does not brake where that
ends, and less where it would swing out too far at a turn."""

GAIN_SHARE = 0.15
"""What a refinement may gain on the way that is followed, as a share of the longest."""

STAGNANT_STEPS = 0.1
"""A plan that would come to stand within this many longest steps of where it would now gets
nowhere."""


class DrivenReach:
    """Plans of one problem; keeps the solvers of its fallbacks."""

    def __init__(self, problem: Problem, scene: Scene) -> None:
        self._problem = problem
        self._scene = scene
        self._cascade = FallbackCascade(problem, scene.ground)

    def chosen(
        self,
        situation: StepContext,
        judge: Judge,
        start: GlobalStart | None,
        node_margin_db: NDArray[np.float64] | None,
        warm: Plan | None,
        budget: Budget,
    ) -> tuple[Candidate, Pivot | None]:
        """Return what is released, and the pivot that it is charged by."""
        judge = _charging(judge, ReachCost(self._problem, judge.position_m, situation.power))
        if start is None:
            return without_guess(judge, warm), None
        if start.is_direct and (direct := self._direct(judge, start, warm)) is not None:
            return direct, None
        starts = self._starts(situation, judge, start, warm)
        ahead = Ahead(self._problem, self._scene, start, node_margin_db)
        cost = ReachCost(
            self._problem, judge.position_m, situation.power, ahead, priced=not start.is_direct
        )
        # Of ways that come too near to obstacles, nobody knows where they would end.
        ends = [resting_places_m(each.drive)[-1] for each in starts if each.clear and each.drive]
        now = np.array(self._problem.robots[0].dynamics.resting_place(tuple(judge.state)))
        shared = self._pivot(start, ends or [now], node_margin_db)

        def own(each: Start) -> Pivot:
            if not each.clear or each.drive is None:
                return shared
            return self._pivot(start, [resting_places_m(each.drive)[-1]], node_margin_db)

        found = self._climb(situation, judge, starts, cost, own, warm, budget)
        if self._gets_nowhere(found):
            # Perhaps the pivot is not seen from here: then the straight way to it leads nowhere.
            nearer = self._pivot(start, [now], node_margin_db)
            if not np.array_equal(nearer.position_m, shared.position_m):
                found = self._climb(situation, judge, starts, cost, lambda _: nearer, warm, budget)
        if start.is_direct:
            found = _named_direct(found, replace(cost, priced=True))
        return found, None if found.drive is None else cost.pivot_of(found.path_m, found.drive)

    def _direct(self, judge: Judge, start: GlobalStart, warm: Plan | None) -> Candidate | None:
        """Drive the shortest path from rest to rest, node by node; None where nobody knows how.

        A robot that moves first comes to rest where its last plan ends.
        """
        problem, settings = self._problem, self._problem.planner
        if not stands(problem, judge.state):
            drive = shifted_drive(problem, warm)
        else:
            away = np.linalg.norm(start.path_m - judge.position_m, axis=1) > STANDSTILL_M
            drive = self._straight(judge, start.path_m[int(np.argmax(away))])
            if drive is None:
                return None
        if drive is not None and len(drive.inputs) == settings.horizon:
            found = judge.judged(
                drive_candidate(judge, drive, Rung.DIRECT, Termination.LATTICE_ONLY)
            )
            if found.sound:
                return found
        return without_guess(judge, warm)

    def _straight(self, judge: Judge, end_m: NDArray[np.float64]) -> Drive | None:
        """Return a drive from rest to rest at a place (2,), up to the horizon; None if unknown."""
        dynamics, settings = self._problem.robots[0].dynamics, self._problem.planner
        inputs = dynamics.straight(judge.state, end_m, settings.step_s)
        if inputs is None:
            return None
        rest = np.zeros((settings.horizon, inputs.shape[1]))
        inputs = np.vstack([inputs, rest])[: settings.horizon]
        return rolled_out(dynamics, judge.state, inputs, settings.step_s)

    def _starts(
        self, situation: StepContext, judge: Judge, start: GlobalStart, warm: Plan | None
    ) -> list[Start]:
        """Ways that the robot can drive: the last plan, along what was found, and straight on."""
        problem, settings = self._problem, self._problem.planner
        dynamics = problem.robots[0].dynamics
        last = last_drive(problem, warm)
        starts = [] if last is None else [driven_start(judge, situation, last)]
        way = np.vstack([start.path_m, start.beyond_m])
        for share in FOLLOWED_HORIZONS:
            count = math.ceil(share * settings.horizon)
            path = np.vstack([way, np.tile(way[-1], (count, 1))])
            path = retime(judge.position_m, path, path[:0], problem.step_length_m - STEP_PAD_M)
            path = path[np.minimum(np.arange(max(count, settings.horizon)), count - 1)]
            inputs = dynamics.following(judge.state, path, settings.step_s)[: settings.horizon]
            followed = rolled_out(dynamics, judge.state, inputs, settings.step_s)
            starts.append(driven_start(judge, situation, followed))
            if any(each.clear for each in starts):
                break
        if stands(problem, judge.state):
            drive = self._straight(judge, start.path_m[-1])
            starts += [] if drive is None else [driven_start(judge, situation, drive)]
        return starts

    def _pivot(
        self,
        start: GlobalStart,
        places_m: list[NDArray[np.float64]],
        node_margin_db: NDArray[np.float64] | None,
    ) -> Pivot:
        """The pivot as seen from that of the places (2,) from which the way on is the shortest."""
        problem, cost_m = self._problem, start.ways.cost_m
        views = [(int(start.nodes[-1]), start.path_m[-1])]
        for place in places_m:
            nodes, lengths = first_moves(self._scene.ground, problem, place)
            if len(nodes):
                views.append((int(nodes[np.argmin(lengths + cost_m[nodes])]), place))
        node, place = min(views[1:] or views, key=lambda view: float(cost_m[view[0]]))
        return find_pivot(
            self._scene,
            replace(start, nodes=np.append(start.nodes[:-1], node)),
            node_margin_db,
            problem.step_length_m,
            problem.constraints.clearance_m,
            place,
        )

    def _climb(
        self,
        situation: StepContext,
        judge: Judge,
        starts: list[Start],
        cost: ReachCost,
        pivot_of: Callable[[Start], Pivot],
        warm: Plan | None,
        budget: Budget,
    ) -> Candidate:
        """Return the best candidate of the starts, each drawn to a pivot."""
        judge = _charging(judge, cost)
        if stops_at_goal(self._problem, judge.state):
            stopped = _stopped(judge)
            if stopped.verdict is Verdict.VERIFIED:
                return stopped
        charged = [
            replace(
                each,
                worth=judge.sense * cost(each.path_m, each.drive),
                charge=self._charge(cost, pivot_of(each), each.drive),
            )
            for each in starts
            if each.drive is not None
        ]
        charged.sort(key=lambda each: (not each.clear, round(each.missing_db, 2), -each.worth))
        return self._cascade.first_verified(situation, judge, charged, warm, budget)

    def _charge(self, cost: ReachCost, pivot: Pivot, drive: Drive) -> GoalCharge:
        """Return the charge of a refinement, by each step that may reach the pivot."""
        problem, horizon = self._problem, len(drive.inputs)
        away = np.linalg.norm(resting_places_m(drive)[1:] - pivot.position_m, axis=1)
        arrived = np.flatnonzero(away <= problem.constraints.goal_radius_m)
        near = GAIN_SHARE * horizon * problem.step_length_m
        steps = int(arrived[0]) + 1 if len(arrived) else horizon
        ends = pivot.cost_m == 0.0 and (len(arrived) > 0 or bool(away[-1] <= near))
        return GoalCharge(
            pivot.position_m,
            problem.reach.effort_weight_s2_m2 / problem.planner.step_s,
            cost.rate_s_m * pivot.metre_cost,
            cost.rate_s_m * (pivot.metre_cost - 1.0),
            1.0 / steps if ends else 0.0,
            ROUNDING_STEPS * problem.step_length_m,
        )

    def _gets_nowhere(self, found: Candidate) -> bool:
        """Return whether a robot would come to stand about where it would if it braked now."""
        if found.drive is None:
            return False
        resting = resting_places_m(found.drive)
        moved = float(np.linalg.norm(resting - resting[0], axis=1).max())
        return moved <= STAGNANT_STEPS * self._problem.step_length_m


def _named_direct(found: Candidate, priced: ReachCost) -> Candidate:
    """Name the fallback of a robot that has wandered; value others at what they cost any robot."""
    if found.rung in (Rung.PLAN, Rung.COLD_RETRY, Rung.LATTICE, Rung.RELAXED):
        return replace(found, rung=Rung.DIRECT)
    return replace(found, objective=priced(found.path_m, found.drive))


def _charging(judge: Judge, cost: ReachCost) -> Judge:
    """The judge by another cost."""

    def of_drive(drive: Drive) -> float:
        return cost(drive.positions_m[1:], drive)

    return replace(judge, objective=cost, objective_of_drive=of_drive)


def _stopped(judge: Judge) -> Candidate:
    """Brake."""
    rung = Rung.LATTICE if judge.problem.planner.name in METHODS else Rung.PLAN
    found = judge.judged(drive_candidate(judge, braked(judge), rung, Termination.LATTICE_ONLY))
    return replace(found, rung=Rung.RELAXED) if found.relaxes else found
