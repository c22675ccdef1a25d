"""One receding-horizon step to a goal: initial guess, refinement, verification, fallbacks.

A robot with dynamics follows the path that the lattice search finds for a single integrator. The
cost-to-go is counted from where it would come to rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.planning.candidates import (
    Budget,
    Candidate,
    Judge,
    best_of,
    braked,
    budget_from,
    drive_candidate,
    solve_limit_s,
    without_guess,
)
from planopt.planning.certificate import (
    MOST_IN_WORDS,
    BlockedError,
    BlockedWay,
    goal_in_words,
    holes_on,
)
from planopt.planning.driven import driven_start, last_drive
from planopt.planning.history import BEGINNING, History
from planopt.planning.horizon_planner import FallbackCascade
from planopt.planning.plan import (
    Pivot,
    Plan,
    Rung,
    Termination,
    Verdict,
    shifted_drive,
    shifted_path,
)
from planopt.planning.programme.clearance_lines import MOVING_LINES
from planopt.planning.programme.goal_value import ROUNDING_STEPS, GoalCharge
from planopt.planning.programme.path_nlp import GOAL, METHODS, PathNlp, build_path_nlp
from planopt.planning.programme.path_rows import PathShape
from planopt.planning.proof.context import VerifierContext, search_prediction, verifier_context
from planopt.planning.proof.motion import stands, stops_at_goal
from planopt.planning.proof.searches import build_goal_grid
from planopt.planning.refine import Refiner
from planopt.planning.reservations import reserved_path
from planopt.planning.scene import Scene, first_moves
from planopt.planning.search.global_search import GlobalSearch, GlobalStart
from planopt.planning.search.pivot import Ahead, find_pivot
from planopt.planning.search.start_search import Start
from planopt.planning.search.taut_way import retime
from planopt.planning.search.timed_search import TimedPath
from planopt.planning.tolerances import STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import Aim, StepContext, step_context
from planopt.planning.values.exploration import workspace_region
from planopt.planning.values.reach_cost import ReachCost, resting_places_m
from planopt.planning.values.rule_rows import RuleRows, step_rows
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive, rolled_out
from planopt.world.moving_discs import MovingDiscs

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
