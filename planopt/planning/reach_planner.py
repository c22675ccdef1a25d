"""Receding-horizon step to a goal: initial guess, refinement, verification, fallbacks."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import numpy as np

from planopt.arrays import Floats
from planopt.channel.posterior import Belief
from planopt.planning.candidates import (
    Budget,
    Candidate,
    Scorer,
    best_of,
    braked,
    budget_from,
    drive_candidate,
    shifted_path,
    verified_of,
    without_guess,
)
from planopt.planning.certificate import (
    BlockedError,
    BlockedPath,
    goal_in_words,
    holes_on,
    named_holes,
)
from planopt.planning.horizon_planner import FallbackCascade, driven_start, last_drive
from planopt.planning.plan import (
    BEGINNING,
    History,
    Pivot,
    Plan,
    Rung,
    Termination,
    Verdict,
    shifted_drive,
)
from planopt.planning.programme.goal_value import ROUNDING_STEPS, GoalCharge
from planopt.planning.programme.path_nlp import METHODS
from planopt.planning.proof.motion import stands, stops_at_goal
from planopt.planning.proof.rule import VerifierContext, search_prediction, verifier_context
from planopt.planning.proof.searches import build_goal_grid
from planopt.planning.refinement import Refinement, goal_value
from planopt.planning.reservations import reserved_path
from planopt.planning.scene import Scene, first_moves, retime
from planopt.planning.search.global_search import Ahead, GlobalSearch, GlobalStart, find_pivot
from planopt.planning.search.guess_search import Guess
from planopt.planning.search.timed_search import TimedPath
from planopt.planning.tolerances import STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import Aim, StepContext, step_context, workspace_region
from planopt.planning.values.objective_value import ReachCost, resting_places_m, step_rows
from planopt.problems.problem import Problem, cruising_speed_m_s
from planopt.robots.dynamics import Drive, rolled_out
from planopt.world.motion import MovingDiscs

FOLLOWED_HORIZONS = (2.0, 0.5, 0.25)
"""Fractions of the horizon over which a robot with dynamics follows the lattice path."""
GAIN_SHARE = 0.15
"""Distance to the goal from which a refinement may still arrive, as a share of the longest plan."""
STAGNANT_STEPS = 0.1
"""Displacement of the resting position up to which a plan counts as stagnant, in longest steps."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """Step context of one robot, with the lattice path found for this step."""

    context: VerifierContext
    step: StepContext  # Planner's context; thresholds are lowered by the bounded slack
    start: GlobalStart | None  # Initial guess; None if no node is reachable
    wall_s: float  # Wall time of the search

    @property
    def state(self) -> Floats:
        """``(s,)`` state of the robot."""
        return self.context.state


@dataclass(frozen=True, eq=False)
class Course:
    """Timed path of one robot to its goal."""

    outlook: Outlook  # Context with the first steps of the path
    places_m: Floats  # (T + 1, 2) initial position and positions after each step
    arrives: bool = True  # False for a path to a refuge, off the other robots' paths


Proposal = Callable[[StepContext, Scorer, Plan | None], Plan]
"""Function that returns a user-defined planner's plan, or a waiting plan if that is rejected."""


class ReachPlanner:
    """Planner of one robot to its goal; it caches solver, lattice and the verifier's grid."""

    def __init__(
        self, problem: Problem, scene: Scene, others: int = 0, proposal: Proposal | None = None
    ) -> None:
        self.problem = problem
        self._proposal = proposal
        self.scene = scene
        self._eased = eased(problem)
        self._search = GlobalSearch(self._eased, scene, others)
        self._region = workspace_region(problem)
        # Only a soft chance constraint needs the grid, which compares costs of paths.
        may_miss = problem.constraints.rule.slack_max_db is None
        self._goal_grid = build_goal_grid(problem, scene.index) if may_miss else None
        self._refinement: Refinement | None = None
        self._driven = None if problem.robots[0].moves_freely else DrivenReach(problem, scene)
        if problem.planner.name in METHODS and self._driven is None:
            self._refinement = Refinement(problem, scene, others)

    def plan(
        self, belief: Belief, state: Floats, warm: Plan | None = None, history: History = BEGINNING
    ) -> Plan:
        """Return a plan from `state` with the current belief."""
        # Shapes: state (s,).
        return self.release(self.outlook(belief, state, history), warm)

    def outlook(self, belief: Belief, state: Floats, history: History = BEGINNING) -> Outlook:
        """Return the step context, and a lattice path found without regard to other robots."""
        begun = perf_counter()
        context = verifier_context(
            self.problem,
            self.scene.index,
            belief.posteriors,
            state,
            history,
            goal_grid=self._goal_grid,
        )
        step = step_context(replace(context, problem=self._eased), self._region, Aim())
        start = self._search.find_start(step)
        if start is not None and start.is_blocked:
            raise self._blocked(step, start)
        return Outlook(context, step, start, perf_counter() - begun)

    def clear_course(self, outlook: Outlook, discs: MovingDiscs) -> Course | None:
        """Return a timed path to the goal that avoids moving discs; None if there is none."""
        search = partial(self._search.clear_course, discs=discs)
        return _course(outlook, search)

    def refuge_course(self, outlook: Outlook, others_m: Floats, steps: int) -> Course | None:
        """Return a timed path to a refuge away from `others_m` (k, 2); None if there is none."""
        search = partial(self._search.refuge_course, others_m=others_m, steps=steps)
        return _course(outlook, search)

    def release(
        self,
        outlook: Outlook,
        warm: Plan | None = None,
        moving: MovingDiscs | None = None,
        reserved_m: Floats | None = None,  # (N, 2)
    ) -> Plan:
        """Return the plan to execute: the lattice path refined and verified, or a fallback."""
        begun = perf_counter() - outlook.wall_s
        problem, position_m = self.problem, outlook.state[:2]
        context, step, start = outlook.context, outlook.step, outlook.start
        if moving is not None:
            context, step = replace(context, moving=moving), replace(step, moving=moving)
        cost = ReachCost(problem, position_m, step.power)
        if reserved_m is None and len(context.moving) and warm is not None:
            reserved_m = reserved_path(position_m, warm.positions_m, problem.planner.horizon)[1:]
        scorer = Scorer(context, cost, reserved_m)
        rejected, ahead = "", None
        connected = problem.reach.cost_to_go == "connected"
        margin_db = self._search.margins.margin_db if connected else None
        budget = budget_from(problem, begun)
        if self._driven is not None:
            chosen, pivot = self._driven.chosen(step, scorer, start, margin_db, warm, budget)
        elif start is None:
            chosen, pivot = without_guess(scorer, warm), None
        else:
            ahead = Ahead(problem, self.scene, start, margin_db)
            cost = replace(cost, ahead=ahead, priced=not start.is_direct)
            scorer = replace(scorer, objective=cost)
            if self._proposal is not None and not (start.gives_way or start.is_direct):
                proposed = self._proposal(step, scorer, warm)
                if proposed.verdict is Verdict.VERIFIED and proposed.rung is Rung.PLAN:
                    pivot = cost.pivot_of(proposed.positions_m[1:])
                    return self._routed(proposed, context, pivot, np.zeros((0, 2)))
                rejected = (
                    proposed.rejected or f"it is {proposed.verdict.value}: {proposed.message}"
                )
            if start.gives_way or start.is_direct:
                # The path is released unrefined if it is sound.
                rung = Rung.GIVE_WAY if start.gives_way else Rung.DIRECT
                chosen = scorer.candidate(start.path_m, rung, Termination.LATTICE_ONLY)
                chosen = scorer.assessed(chosen)
                if not chosen.sound:
                    if not start.gives_way:
                        scorer = replace(scorer, objective=replace(cost, priced=True))
                    chosen = without_guess(scorer, warm)
            else:
                lattice = scorer.candidate(start.path_m, Rung.LATTICE, Termination.LATTICE_ONLY)
                guesses: list[tuple[Guess, Rung]] = []
                if self._refinement is not None and _moves(scorer, start.path_m):
                    near = partial(goal_value, cost, ahead.leading)
                    guesses = [
                        (Guess(path, scorer.score(lattice), 0.0, clear=False, near=near), rung)
                        for path, rung in self._guesses(step, scorer, start, ahead, lattice, warm)
                    ]
                candidates = list(self._candidates(step, scorer, guesses, lattice, budget))
                chosen = best_of(scorer, candidates, warm, scorer.score(lattice))
            pivot = cost.pivot_of(chosen.path_m)
        plan = scorer.plan_from(chosen, wall_s=perf_counter() - begun)
        route = np.zeros((0, 2)) if start is None else start.route_m
        if start is not None and not (start.gives_way or start.is_direct):
            ahead = ahead or Ahead(problem, self.scene, start, margin_db)
            route = ahead.route_m(plan.positions_m[-1])
        return self._routed(replace(plan, rejected=rejected), context, pivot, route)

    def _routed(
        self, plan: Plan, context: VerifierContext, pivot: Pivot | None, route_m: Floats
    ) -> Plan:
        """Return the plan with its route to the goal, and with coverage holes on path and route."""
        places = np.vstack([plan.positions_m, route_m])
        holes = holes_on(self.problem, search_prediction(context.law, places), places)
        return replace(plan, pivot=pivot, route_m=route_m, holes=holes)

    def _blocked(self, step: StepContext, start: GlobalStart) -> BlockedError:
        """Return the error for a blocked goal, with the coverage holes of the cheapest path."""
        constraints = self.problem.constraints
        places = np.vstack([step.position_m, start.path_m, start.route_m])
        holes = holes_on(self.problem, step.power(places), places)
        named = named_holes(holes, "a coverage hole of ")
        blocked = (
            f"no path to the goal {list(self.problem.goal_m)} keeps constraints.p_min "
            f"{constraints.p_min:g} with constraints.slack_max_db "
            f"{constraints.rule.slack_max_db:g}: the cheapest crosses {', '.join(named)}"
        )
        words = "; ".join([blocked, *goal_in_words(self.problem, holes)])
        return BlockedError(words, (BlockedPath(self.problem.robots[0].name, places, holes),))

    def _guesses(
        self,
        step: StepContext,
        scorer: Scorer,
        start: GlobalStart,
        ahead: Ahead,
        lattice: Candidate,
        warm: Plan | None,
    ) -> list[tuple[Floats, Rung]]:
        """Return initial guesses (N, 2), best first, marked RELAXED if they violate p_min."""
        # If the shifted last plan costs less than the lattice path, it is the best guess.
        problem = self.problem
        guesses = [(start.path_m, Rung.RELAXED)]
        if not (start.margin_db < 0.0).any():
            effort, fastest = problem.reach.effort_weight_s2_m2, problem.robots[0].speed_max_m_s
            step_m = cruising_speed_m_s(effort, fastest) * problem.planner.step_s - STEP_PAD_M
            retimed = retime(scorer.position_m, start.path_m, start.beyond_m, step_m)
            guesses = [(retimed, Rung.PLAN), (start.path_m, Rung.COLD_RETRY)]
        shifted_m = shifted_path(scorer, warm)
        if shifted_m is not None:
            # The last step moves towards the terminal waypoint.
            before = shifted_m[-1]
            to_pivot = ahead.leading(before).position_m - before
            away, longest = float(np.linalg.norm(to_pivot)), problem.step_length_m - STEP_PAD_M
            goal_away = np.linalg.norm(before - np.asarray(problem.goal_m))
            if len(shifted_m) > 1 and away and goal_away > problem.constraints.goal_radius_m:
                last = before + to_pivot * min(1.0, longest / away)
                shifted_m = np.vstack([shifted_m[:-1], last])
            is_best = scorer.objective(shifted_m) < lattice.objective
            rung = Rung.PLAN if is_best else Rung.COLD_RETRY
            margins = step_rows(step, shifted_m).margins_db(step.power(shifted_m))
            rung = Rung.RELAXED if (margins < 0.0).any() else rung
            guesses.insert(0 if is_best else len(guesses), (shifted_m, rung))
        return guesses

    def _candidates(
        self,
        step: StepContext,
        scorer: Scorer,
        guesses: list[tuple[Guess, Rung]],
        lattice: Candidate,
        budget: Budget,
    ) -> Iterator[Candidate]:
        """Yield candidates, most promising first: refined guesses, then the lattice path."""
        if self._refinement is not None and guesses:
            refined = partial(self._refinement.candidates, step, scorer, budget=budget)
            for guess, rung in guesses:
                found = refined(guess, rung)
                for each in verified_of(found):
                    sooner_m = self._sooner(scorer, each.path_m)
                    if sooner_m is not None:
                        found = [*refined(replace(guess, path_m=sooner_m), each.rung), *found]
                yield from found
                if any(each.objective <= lattice.objective for each in verified_of(found)):
                    return
                if any(each.sound and each.hopeless for each in found):
                    break
            if budget.spent:
                lattice = replace(lattice, termination=Termination.TIME_LIMIT)
        lattice = scorer.assessed(lattice)
        if self._refinement is None:
            lattice = replace(lattice, rung=Rung.PLAN)
        yield replace(lattice, rung=Rung.RELAXED) if lattice.relaxes else lattice

    def _sooner(self, scorer: Scorer, path_m: Floats) -> Floats | None:
        """Return a path (N, 2) at full speed if that reaches the goal sooner, else None."""
        problem = self.problem
        away = np.linalg.norm(path_m - np.asarray(problem.goal_m), axis=1)
        there = np.flatnonzero(away <= problem.constraints.goal_radius_m)
        if not there.size or there[0] == 0:
            return None
        step_m = problem.step_length_m - STEP_PAD_M
        faster = retime(scorer.position_m, path_m, path_m[:0], step_m)
        return faster if (faster[there[0] - 1] == faster[-1]).all() else None


def _course(
    outlook: Outlook,
    search: Callable[[Floats, GlobalStart], tuple[GlobalStart, Floats, TimedPath] | None],
) -> Course | None:
    """Return the path found by `search` as a course; None if there is none."""
    begun = perf_counter()
    found = None if outlook.start is None else search(outlook.state[:2], outlook.start)
    if found is None:
        return None
    start, places, path = found
    spent = outlook.wall_s + perf_counter() - begun
    return Course(replace(outlook, start=start, wall_s=spent), places, path.arrives)


def eased(problem: Problem) -> Problem:
    """Return the problem without slack, with thresholds lowered by the allowed slack."""
    rule = problem.constraints.rule
    if not rule.slack_max_db:
        return problem
    slack_db = rule.slack_max_db
    lower = tuple(
        replace(radio, threshold_dbm=radio.threshold_dbm - slack_db) for radio in problem.stations
    )
    hard = replace(problem.constraints, rule=replace(rule, slack_max_db=0.0))
    return replace(problem, stations=lower, constraints=hard)


def _moves(scorer: Scorer, path_m: Floats) -> bool:
    """Return whether any step of a path moves; only then is a refinement useful."""
    steps = np.diff(np.vstack([scorer.position_m, path_m]), axis=0)
    return bool((np.linalg.norm(steps, axis=1) > STANDSTILL_M).any())


class DrivenReach:
    """Refinement of a lattice path to a goal for a robot with dynamics."""

    def __init__(self, problem: Problem, scene: Scene) -> None:
        self._problem = problem
        self._scene = scene
        self._dynamics = problem.robots[0].dynamics
        self._cascade = FallbackCascade(problem, scene)

    def chosen(
        self,
        step: StepContext,
        scorer: Scorer,
        start: GlobalStart | None,
        node_margin_db: Floats | None,
        warm: Plan | None,
        budget: Budget,
    ) -> tuple[Candidate, Pivot | None]:
        """Return the candidate to release, and the terminal waypoint of its cost-to-go, if any."""
        if start is None:
            return without_guess(scorer, warm), None
        if start.is_direct and (direct := self._direct(step, scorer, start, warm)):
            return direct, None
        starts = self._starts(step, scorer, start, warm)
        ahead = Ahead(self._problem, self._scene, start, node_margin_db)
        cost = ReachCost(
            self._problem, scorer.position_m, step.power, ahead, priced=not start.is_direct
        )
        now = np.array(self._dynamics.resting_place(tuple(scorer.state)))
        # A drive that violates clearance predicts no useful resting position.
        rests = [resting_places_m(each.drive)[-1] for each in starts if each.clear and each.drive]
        shared = self._pivot(start, rests or [now], node_margin_db)

        def own(each: Guess) -> Pivot:
            if not each.clear or each.drive is None:
                return shared
            return self._pivot(start, [resting_places_m(each.drive)[-1]], node_margin_db)

        found = self._climb(step, scorer, starts, cost, own, warm, budget)
        if self._is_stagnant(found):
            # If an obstacle hides the common pivot from the robot, straight drives to it stagnate.
            nearer = self._pivot(start, [now], node_margin_db)
            if not np.array_equal(nearer.position_m, shared.position_m):
                found = self._climb(step, scorer, starts, cost, lambda _: nearer, warm, budget)
        if start.is_direct:
            if found.rung in (Rung.PLAN, Rung.COLD_RETRY, Rung.LATTICE, Rung.RELAXED):
                found = replace(found, rung=Rung.DIRECT)
            else:
                priced = replace(cost, priced=True)
                found = replace(found, objective=priced(found.path_m, found.drive))
        return found, None if found.drive is None else cost.pivot_of(found.path_m, found.drive)

    def _direct(
        self, step: StepContext, scorer: Scorer, start: GlobalStart, warm: Plan | None
    ) -> Candidate | None:
        """Return a candidate that stops at each node of the shortest path; None if not possible."""
        if not stands(self._problem, scorer.state):
            drive = shifted_drive(self._problem, warm)
        else:
            away = np.linalg.norm(start.path_m - scorer.position_m, axis=1) > STANDSTILL_M
            drive = self._straight(scorer, start.path_m[int(np.argmax(away))])
            if drive is None:
                return None
        if drive is not None and len(drive.inputs) == self._problem.planner.horizon:
            cost = ReachCost(self._problem, scorer.position_m, step.power, priced=False)
            free = replace(scorer, objective=cost)
            found = drive_candidate(free, drive, Rung.DIRECT, Termination.LATTICE_ONLY)
            if (found := scorer.assessed(found)).sound:
                return found
        return without_guess(scorer, warm)

    def _drive(self, scorer: Scorer, inputs: Floats) -> Drive:
        """Return the trajectory for the inputs (N, m) from the robot's state."""
        return rolled_out(self._dynamics, scorer.state, inputs, self._problem.planner.step_s)

    def _straight(self, scorer: Scorer, end_m: Floats) -> Drive | None:
        """Return an N-step drive from rest to rest at a position (2,); None if unavailable."""
        settings = self._problem.planner
        inputs = self._dynamics.straight(scorer.state, end_m, settings.step_s)
        if inputs is None:
            return None
        rest = np.zeros((settings.horizon, inputs.shape[1]))
        return self._drive(scorer, np.vstack([inputs, rest])[: settings.horizon])

    def _starts(
        self, step: StepContext, scorer: Scorer, start: GlobalStart, warm: Plan | None
    ) -> list[Guess]:
        """Return initial guesses: the previous plan, drives along the path, and straight drives."""
        problem, settings = self._problem, self._problem.planner
        last = last_drive(problem, warm)
        starts = [] if last is None else [driven_start(scorer, step, last)]
        whole = np.vstack([start.path_m, start.beyond_m])
        for share in FOLLOWED_HORIZONS:
            count = math.ceil(share * settings.horizon)
            path = np.vstack([whole, np.tile(whole[-1], (count, 1))])
            path = retime(scorer.position_m, path, path[:0], problem.step_length_m - STEP_PAD_M)
            path = path[np.minimum(np.arange(max(count, settings.horizon)), count - 1)]
            inputs = self._dynamics.following(scorer.state, path, settings.step_s)
            drive = self._drive(scorer, inputs[: settings.horizon])
            starts.append(driven_start(scorer, step, drive))
            if any(each.clear for each in starts):
                break
        if stands(problem, scorer.state):
            drive = self._straight(scorer, start.path_m[-1])
            starts += [] if drive is None else [driven_start(scorer, step, drive)]
        return starts

    def _pivot(
        self, start: GlobalStart, places_m: list[Floats], node_margin_db: Floats | None
    ) -> Pivot:
        """Return the terminal waypoint seen from the position in `places_m` of least cost-to-go."""
        problem, cost_m = self._problem, start.cost_to_go.cost_m
        views = [(int(start.nodes[-1]), start.path_m[-1])]
        for place in places_m:
            nodes, lengths = first_moves(self._scene, problem, place)
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
        step: StepContext,
        scorer: Scorer,
        starts: list[Guess],
        cost: ReachCost,
        pivot_of: Callable[[Guess], Pivot],
        warm: Plan | None,
        budget: Budget,
    ) -> Candidate:
        """Return the best refinement of initial guesses with different terminal waypoints."""
        scorer = replace(scorer, objective=cost)
        if stops_at_goal(self._problem, scorer.state):
            rung = Rung.LATTICE if self._problem.planner.name in METHODS else Rung.PLAN
            stop = drive_candidate(scorer, braked(scorer), rung, Termination.LATTICE_ONLY)
            stop = scorer.assessed(stop)
            if stop.verdict is Verdict.VERIFIED:
                return replace(stop, rung=Rung.RELAXED) if stop.relaxes else stop
        charged = [
            replace(
                each,
                value=scorer.sense * cost(each.path_m, each.drive),
                charge=self._charge(cost, pivot_of(each), each.drive),
            )
            for each in starts
            if each.drive is not None
        ]
        charged.sort(key=lambda each: (not each.clear, round(each.missing_db, 2), -each.value))
        return self._cascade.first_verified(step, scorer, charged, warm, budget)

    def _charge(self, cost: ReachCost, pivot: Pivot, drive: Drive) -> GoalCharge:
        """Return the goal cost's parameters; near the goal, the cost applies to each step."""
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

    def _is_stagnant(self, found: Candidate) -> bool:
        """Return whether a plan comes to rest near the position where braking now would end."""
        if found.drive is None:
            return False
        resting = resting_places_m(found.drive)
        moved = float(np.linalg.norm(resting - resting[0], axis=1).max())
        return moved <= STAGNANT_STEPS * self._problem.step_length_m
