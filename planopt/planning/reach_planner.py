"""One receding-horizon step to a goal: initial guess, refinement, verification, fallbacks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.planning.budget import Budget, budget_from, solve_limit_s
from planopt.planning.driven_reach import DrivenReach
from planopt.planning.fallbacks import best_of, without_guess
from planopt.planning.history import BEGINNING, History
from planopt.planning.holes import (
    MOST_IN_WORDS,
    BlockedError,
    BlockedWay,
    goal_in_words,
    holes_on,
)
from planopt.planning.judge import Candidate, Judge
from planopt.planning.plan import Plan, Rung, Termination, Verdict, shifted_path
from planopt.planning.programme.clearance_lines import MOVING_LINES
from planopt.planning.programme.path_nlp import GOAL, METHODS, PathNlp, build_path_nlp
from planopt.planning.programme.path_shape import PathShape
from planopt.planning.programme.pivot import Ahead
from planopt.planning.proof.context import VerifierContext, verifier_context
from planopt.planning.proof.goal_paths import build_goal_grid
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.refine import Refiner
from planopt.planning.scene import Scene
from planopt.planning.search.global_search import GlobalSearch, GlobalStart
from planopt.planning.search.timed_search import TimedPath
from planopt.planning.team.reservations import reserved_path
from planopt.planning.tolerances import STANDSTILL_M
from planopt.planning.values.context import Aim, StepContext, step_context
from planopt.planning.values.exploration import workspace_region
from planopt.planning.values.reach_cost import ReachCost
from planopt.planning.values.rule_rows import RuleRows, step_rows
from planopt.problems.problem import Problem
from planopt.world.moving_discs import MovingDiscs

LINES_PER_SEGMENT = 4
"""Nearest convex pieces that each segment is kept from; the verifier looks at all."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """The place and belief of a robot, and the path that it would drive."""

    context: VerifierContext  # What its plan is verified with
    situation: StepContext  # What its step is planned on; beside it only moving obstacles move
    start: GlobalStart | None  # The path; None if no node is in reach
    wall_s: float  # What it took to find

    @property
    def state(self) -> NDArray[np.float64]:
        """``(s,)`` the robot's state."""
        return self.context.state


class ReachPlanner:
    """Plans for one problem; keeps what can be reused from step to step."""

    def __init__(self, problem: Problem, scene: Scene, others: int = 0) -> None:
        self.problem = problem
        self.scene = scene
        self._eased = eased(problem)
        self._search = GlobalSearch(self._eased, scene, others)
        self._region = workspace_region(problem)
        # What the verifier compares prices on; a bound that may not be missed has none.
        may_miss = problem.constraints.rule.slack_max_db is None
        self._goal_grid = build_goal_grid(problem, scene.index) if may_miss else None
        self._nlp: PathNlp | None = None
        self._driven = None if problem.robots[0].moves_freely else DrivenReach(problem, scene)
        if problem.planner.name in METHODS and self._driven is None:
            moving = len(problem.workspace.moving) + others
            lines = LINES_PER_SEGMENT + min(moving, MOVING_LINES)
            shape = PathShape(problem.planner.horizon, lines, "chain", bounded=True, slacked=False)
            method, limit_s = METHODS[problem.planner.name], solve_limit_s(problem)
            self._nlp = build_path_nlp(shape, method, limit_s, GOAL)

    def plan(
        self,
        belief: Belief,
        state: NDArray[np.float64],  # (s,)
        warm: Plan | None = None,
        history: History = BEGINNING,
    ) -> Plan:
        """Plan from `state` on what is believed now."""
        return self.release(self.outlook(belief, state, history), warm)

    def outlook(
        self, belief: Belief, state: NDArray[np.float64], history: History = BEGINNING
    ) -> Outlook:
        """Search the path that the robot would drive if it were alone; arguments as of `plan`."""
        begun = perf_counter()
        context = verifier_context(
            self.problem,
            self.scene.index,
            belief.posteriors,
            state,
            history,
            goal_grid=self._goal_grid,
        )
        situation = step_context(replace(context, problem=self._eased), self._region, Aim())
        start = self._search.find_start(situation)
        if start is not None and start.is_blocked:
            raise self._blocked(situation, start)
        return Outlook(context, situation, start, perf_counter() - begun)

    def beside(
        self, outlook: Outlook, discs: MovingDiscs
    ) -> tuple[Outlook, NDArray[np.float64], bool] | None:
        """Search a path that keeps from `discs` all the way to the goal; None if there is none."""
        begun = perf_counter()
        if outlook.start is None:
            return None
        found = self._search.beside(outlook.state[:2], outlook.start, discs)
        return _changed(outlook, found, begun)

    def aside(
        self, outlook: Outlook, others_m: NDArray[np.float64], steps: int
    ) -> tuple[Outlook, NDArray[np.float64], bool] | None:
        """Search a path off all places (k, 2) that others drive through; as :meth:`beside`."""
        begun = perf_counter()
        if outlook.start is None:
            return None
        found = self._search.aside(outlook.state[:2], outlook.start, others_m, steps)
        return _changed(outlook, found, begun)

    def release(
        self,
        outlook: Outlook,
        warm: Plan | None = None,
        moving: MovingDiscs | None = None,
        reserved_m: NDArray[np.float64] | None = None,  # (N, 2)
    ) -> Plan:
        """Refine and verify the path of an outlook, or fall back."""
        begun = perf_counter() - outlook.wall_s
        problem, scene, position_m = self.problem, self.scene, outlook.state[:2]
        context, situation, start = outlook.context, outlook.situation, outlook.start
        if moving is not None:
            context = replace(context, moving=moving)
            situation = replace(situation, moving=moving)
        moving = context.moving
        plain = problem.constraints.rule.is_plain
        rows_of = None if plain else partial(step_rows, situation)
        cost = ReachCost(problem, position_m, situation.power)
        if reserved_m is None and len(moving) and warm is not None:
            reserved_m = reserved_path(position_m, warm.positions_m, problem.planner.horizon)[1:]
        judge = Judge(context, cost, reserved_m)
        connected = problem.reach.cost_to_go == "connected"
        margin_db = self._search.margins.margin_db if connected else None
        budget = budget_from(problem, begun)
        if self._driven is not None:
            chosen, pivot = self._driven.chosen(situation, judge, start, margin_db, warm, budget)
        elif start is None:
            chosen, pivot = without_guess(judge, warm), None
        else:
            ahead = Ahead(problem, scene, start, margin_db)
            cost = replace(cost, ahead=ahead, priced=not start.is_direct)
            judge = replace(judge, objective=cost)
            if start.gives_way or start.is_direct:
                chosen = self._as_found(judge, cost, start, warm)
            else:
                lattice = judge.candidate(start.path_m, Rung.LATTICE, Termination.LATTICE_ONLY)
                tried = self._candidates(judge, cost, start, lattice, ahead, warm, budget, rows_of)
                chosen = best_of(judge, list(tried), warm, judge.worth(lattice))
            pivot = cost.pivot_of(chosen.path_m)
        plan = judge.plan_from(chosen, wall_s=perf_counter() - begun)
        route = np.zeros((0, 2)) if start is None else start.route_m
        places = np.vstack([plan.positions_m, route])
        power = search_prediction(context.law, places)
        holes = holes_on(problem, power, places)
        return replace(plan, pivot=pivot, route_m=route, holes=holes)

    def _blocked(self, situation: StepContext, start: GlobalStart) -> BlockedError:
        """Return the error that says where contact would have to be left, and for how long."""
        constraints = self.problem.constraints
        places = np.vstack([situation.position_m, start.path_m, start.route_m])
        holes = holes_on(self.problem, situation.power(places), places)
        told = sorted(holes, key=lambda hole: -hole.length_m)[:MOST_IN_WORDS]
        named = [f"a coverage hole of {hole.words}" for hole in holes if hole in told]
        if len(told) < len(holes):
            named.append(f"{len(holes) - len(told)} shorter ones")
        blocked = (
            f"no path to the goal {list(self.problem.goal_m)} keeps constraints.p_min "
            f"{constraints.p_min:g} with constraints.slack_max_db "
            f"{constraints.rule.slack_max_db:g}: the cheapest crosses {', '.join(named)}"
        )
        words = "; ".join([blocked, *goal_in_words(self.problem, holes)])
        return BlockedError(words, (BlockedWay(self.problem.robots[0].name, places, holes),))

    def _candidates(
        self,
        judge: Judge,
        cost: ReachCost,
        start: GlobalStart,
        lattice: Candidate,
        ahead: Ahead,
        warm: Plan | None,
        budget: Budget,
        rows_of: Callable[[NDArray[np.float64]], RuleRows] | None,
    ) -> Iterator[Candidate]:
        """Yield candidates in order of promise: refined guesses, then the lattice path."""
        if self._nlp is not None and np.any(_moving(judge, start.path_m)):
            refiner = Refiner(
                self._nlp,
                self.scene,
                judge,
                cost,
                start,
                ahead,
                lattice.objective,
                budget,
                rows_of,
            )
            shifted = shifted_path(self.problem, judge.index, judge.position_m, warm)
            for attempt in refiner.attempts(shifted):
                yield attempt
                if attempt.verdict is Verdict.VERIFIED and attempt.objective <= lattice.objective:
                    return
                if attempt.sound and attempt.hopeless:
                    break
            if budget.spent:
                lattice = replace(lattice, termination=Termination.TIME_LIMIT)
        lattice = judge.judged(lattice)
        if self._nlp is None:
            lattice = replace(lattice, rung=Rung.PLAN)
        yield replace(lattice, rung=Rung.RELAXED) if lattice.relaxes else lattice

    def _as_found(
        self, judge: Judge, cost: ReachCost, start: GlobalStart, warm: Plan | None
    ) -> Candidate:
        """Return the path of a search that is not to be refined; without it the fallbacks."""
        rung = Rung.GIVE_WAY if start.gives_way else Rung.DIRECT
        found = judge.judged(judge.candidate(start.path_m, rung, Termination.LATTICE_ONLY))
        if found.sound:
            return found
        if not start.gives_way:
            judge = replace(judge, objective=replace(cost, priced=True))
        return without_guess(judge, warm)


def _changed(
    outlook: Outlook,
    found: tuple[GlobalStart, NDArray[np.float64], TimedPath] | None,
    begun: float,
) -> tuple[Outlook, NDArray[np.float64], bool] | None:
    """Return an outlook with another path, found since `begun`."""
    if found is None:
        return None
    start, places, path = found
    spent = outlook.wall_s + perf_counter() - begun
    return replace(outlook, start=start, wall_s=spent), places, path.arrives


def eased(problem: Problem) -> Problem:
    """The problem with its threshold lowered by the slack that is allowed, which costs nothing."""
    rule = problem.constraints.rule
    if not rule.slack_max_db:
        return problem
    slack_db = rule.slack_max_db
    lower = tuple(
        replace(radio, threshold_dbm=radio.threshold_dbm - slack_db) for radio in problem.stations
    )
    hard = replace(problem.constraints, rule=replace(rule, slack_max_db=0.0))
    return replace(problem, stations=lower, constraints=hard)


def _moving(judge: Judge, path_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which steps of a path move at all; a path that stands still needs no refinement."""
    steps = np.diff(np.vstack([judge.position_m, path_m]), axis=0)
    return np.linalg.norm(steps, axis=1) > STANDSTILL_M
