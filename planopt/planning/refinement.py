"""Refinement of initial guesses into verified candidates, for sums of terms and for goals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from planopt.arrays import Floats
from planopt.channel.prediction import Prediction
from planopt.objectives.reach import cruising_speed_m_s
from planopt.objectives.stage_power import scores_of, stage_predictor
from planopt.planning.candidates import Budget, Candidate, Scorer, solve_limit_s
from planopt.planning.certificate import RuleResult
from planopt.planning.plan import Rung, Termination, Verdict
from planopt.planning.programme.goal_value import GoalValue, OutagePrice, margins_of
from planopt.planning.programme.path_nlp import METHODS, PathNlp, build_path_nlp, near_start
from planopt.planning.programme.path_polish import (
    LINE_REACH_STEPS,
    REPAIRS,
    MotionTask,
    PathTask,
    RefinedPath,
    lines_about,
    lines_with_violated,
    moving_count,
    polish_path,
    tail_count,
)
from planopt.planning.programme.solver import MotionShape, PathShape
from planopt.planning.proof.context import SEARCH_ERROR_DB, is_search_exact, obstacles_ahead
from planopt.planning.proof.motion import is_at_goal
from planopt.planning.proof.rule import rule_of
from planopt.planning.scene import Ground, Scene, retime
from planopt.planning.search.global_search import GlobalStart
from planopt.planning.search.guess_search import Guess
from planopt.planning.search.pivot import Ahead
from planopt.planning.tolerances import MARGIN_PAD_DB, MARGIN_TOLERANCE_DB, STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import StepContext, structure_of
from planopt.planning.values.local_value import local_value
from planopt.planning.values.objective_value import ReachCost
from planopt.planning.values.rule_rows import (
    RuleRows,
    has_step_rows,
    has_sum_row,
    rows_again,
    rule_rows,
    step_rows,
)
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive, braked_motion, rolled_out
from planopt.targets.rounding import Derivatives
from planopt.world.moving_discs import MovingDiscs
from planopt.world.separation import (
    SeparatingLines,
    joined_lines,
    separating_lines,
    split_lines,
    tail_lines,
)


def candidate_of(
    scorer: Scorer,
    point: RefinedPath,
    rung: Rung,
    lattice_objective: float,
    solve_s: float,
    drive: Drive | None = None,
) -> Candidate:
    """Return a refined path as a candidate, not yet verified."""
    path = point.path_m if drive is None else drive.positions_m[1:]
    return replace(
        scorer.candidate(path, rung, point.termination, drive),
        lattice_objective=lattice_objective,
        solve_s=solve_s,
        iterations=point.iterations,
        kkt_residual=point.kkt_residual,
        multipliers=point.multipliers,
    )


LOCAL_PAD_DB = 0.04
"""Pad in dB for errors of the local channel model, exceeded by one in ten returned paths (48
neighbours, 1,000 measurements, xi 4 dB, beta 20 m)."""

GIVEN_UP_DB = 1e-3
"""Slack in dB that counts as solver tolerance."""

MISSING_DB_COST = 100.0
"""Cost per dB of slack in the solver if the guess violates the constraint beyond the slack."""


def tightened(task: PathTask, rows: RuleRows, power: Prediction, *, feasible: bool) -> Floats:
    """Return a task's constraint bounds, tightened by the local model's error at its path.

    With `feasible`, constraints that the path satisfies by the exact `power` stay feasible.
    """
    local, per_db = task.evaluate(task.path_m).rows, rows.per_db(power)
    missing = rows.total - rows.achieved(power)
    bound = missing + local + LOCAL_PAD_DB * per_db
    kept = feasible & (missing <= MARGIN_TOLERANCE_DB * per_db)
    return np.where(kept, np.minimum(bound, local), bound)


def with_bounds(task: PathTask, context: StepContext, rows: RuleRows) -> PathTask:
    """Return the task with connectivity constraints, relaxed where the guess violates them.

    All rows have bounded slack at its price. A row that the guess violates by more has unlimited
    slack at a higher price.
    """
    constraints = context.problem.constraints
    if not constraints.asks_connection:
        return task
    power, rule = context.predicted(task.path_m), constraints.rule
    short_db, allowed = rows.shortfall_db(power), rule.slack_max_db or 0.0
    limit = np.where(short_db <= allowed + MARGIN_TOLERANCE_DB, allowed, np.inf)
    weight = MISSING_DB_COST
    if allowed > 0.0 and not np.isinf(limit).any():
        shared = 1 if rule.by_step else max(int(rows.bounded.sum()), 1)
        weight = task.scale * rule.slack_price / shared
    return replace(
        task,
        bound=tightened(task, rows, power, feasible=True),
        per_db=rows.per_db(power),
        slack_limit_db=np.where(np.isneginf(short_db), 0.0, limit),
        slack_weight=weight,
    )


def lacks(
    context: StepContext, rows: RuleRows, point: RefinedPath, *, firmly: bool = False
) -> bool:
    """Return whether a solver's path violates a constraint that it satisfies by the local model.

    With `firmly`, a margin below the error of search predictions counts as a violation, since
    verification may be expensive.
    """
    if not len(point.slack_db) or not np.isfinite(point.path_m).all():
        return False
    short_db = rows.shortfall_db(context.predicted(point.path_m))
    unsure = firmly and rows.weight is None and not is_search_exact(context.posterior)
    most = -SEARCH_ERROR_DB if unsure else MARGIN_TOLERANCE_DB
    return bool((short_db[point.slack_db <= GIVEN_UP_DB] > most).any())


def moved(
    task: PathTask, context: StepContext, rows: RuleRows, path_m: Floats, drive: Drive | None
) -> PathTask:
    """Return the task for another guess, with the local channel model around its path (N, 2)."""
    evaluate, motion = local_value(context, path_m, rows), task.motion
    if motion is not None and drive is not None:
        motion = replace(motion, drive=drive)
    return replace(task, path_m=path_m, evaluate=evaluate, motion=motion)


LINES_PER_SEGMENT = 2
"""Number of nearest convex pieces with a separating line per segment; the verifier checks all."""

ALLOCATIONS = 6
"""Maximum number of refinements, each of which redistributes the total risk over the steps."""

VALUE_IN_SOLVER = 10.0
"""Value to which the guess's objective is scaled, since solver tolerances are absolute."""

RETURNED = frozenset((Termination.CONVERGED, Termination.ACCEPTABLE))
"""Terminations whose point may be the guess of another solve."""


class GuessRefinement:
    """Refinement of guesses for sums of terms; it caches the built solvers."""

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem = problem
        self._ground = ground
        self._built: dict[int, PathNlp] = {}
        self._nlp_for(obstacles_ahead(problem, 0))

    def _nlp_for(self, discs: MovingDiscs) -> PathNlp:
        """Return the solver for this number of moving discs, built on first use."""
        settings = self._problem.planner
        lines = LINES_PER_SEGMENT + moving_count(discs) + tail_count(discs, settings.horizon)
        if lines not in self._built:
            robot, motion = self._problem.robots[0], None
            if not robot.moves_freely:
                motion = MotionShape(robot.dynamics, settings.step_s, settings.horizon, lines)
            shape = PathShape(
                settings.horizon,
                lines,
                structure_of(self._problem),
                has_step_rows(self._problem),
                has_sum_row(self._problem),
                motion,
                charged=self._problem.task == "reach",
            )
            self._built[lines] = build_path_nlp(
                shape,
                METHODS[settings.name],
                solve_limit_s(self._problem),
                near_start(shape, until_settled=True),
            )
        return self._built[lines]

    def candidates(
        self,
        context: StepContext,
        scorer: Scorer,
        guess: Guess,
        rung: Rung,
        budget: Budget | None = None,
    ) -> list[Candidate]:
        """Return refined candidates of a guess, verified; none once the budget is spent."""
        budget = Budget() if budget is None else budget
        problem, moving = self._problem, context.moving
        nlp = self._nlp_for(moving)
        if budget.spent:
            return []
        rows = rule_rows(context, guess.path_m)
        lines, stop = self._lines_about(context, guess.path_m, guess.drive, nlp.shape.lines)
        motion = None
        if nlp.shape.motion is not None and guess.drive is not None:
            motion = MotionTask(nlp.shape.motion, guess.drive, stop)
        # A goal's cost is scaled by the horizon in seconds.
        value = guess.value
        if guess.charge is not None:
            value = problem.planner.step_s * len(guess.path_m)
        task = PathTask(
            start_m=context.position_m,
            path_m=guess.path_m,
            lines=lines,
            clearance_m=problem.constraints.clearance_m,
            step_length_m=problem.step_length_m,
            bounds_m=problem.workspace.bounds_m,
            evaluate=local_value(context, guess.path_m, rows),
            scale=VALUE_IN_SOLVER / (abs(value) or VALUE_IN_SOLVER),
            motion=motion,
            charge=guess.charge,
        )
        task = with_bounds(task, context, rows)
        correlates = rule_of(problem).correlates(problem.constraints.p_min)
        allocations = ALLOCATIONS if correlates else 0
        found: list[Candidate] = []
        earlier: list[tuple[float, RuleResult]] = []
        for attempt in range(REPAIRS + allocations):
            begun = perf_counter()
            point = polish_path(nlp, task)
            drive: Drive | None = None
            if point.inputs is not None:
                dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s
                drive = rolled_out(dynamics, scorer.state, point.inputs, step_s)
            solve_s, lattice = perf_counter() - begun, scorer.sense * guess.value
            candidate = candidate_of(scorer, point, rung, lattice, solve_s, drive)
            if lacks(context, rows, point, firmly=attempt == 0):
                # The local model was inaccurate, and verification is expensive.
                found.append(candidate)
                if budget.spent or point.termination not in RETURNED:
                    return found
                # The next solve corrects the local model by its error at the returned path.
                task = moved(task, context, rows, point.path_m, drive)
                power = context.predicted(point.path_m)
                task = replace(task, bound=tightened(task, rows, power, feasible=False))
                continue
            improvable = guess.clear and guess.missing_db == 0.0 and not allocations
            if improvable and scorer.score(candidate) < guess.value:
                # The guess itself is verified instead.
                return [*found, candidate]
            candidate = scorer.assessed(candidate)
            if candidate.relaxes:
                candidate = replace(candidate, rung=Rung.RELAXED)
            found.append(candidate)
            repaired = self._repaired(task, context, candidate)
            if budget.spent:
                return found
            if repaired is not None:
                task = repaired
                continue
            result = None if candidate.certificate is None else candidate.certificate.rule
            if not allocations or result is None:
                return found
            again = rows_again(context, rows, candidate.path_m, earlier, result)
            if again is None:
                return found
            rows, allocations = again, allocations - 1
            task = moved(task, context, rows, candidate.path_m, drive)
            task = with_bounds(task, context, rows)
        return found

    def _repaired(
        self, task: PathTask, context: StepContext, candidate: Candidate
    ) -> PathTask | None:
        """Return the task with separating lines for a candidate's collisions; None without any."""
        if candidate.sound or not np.isfinite(candidate.path_m).all():
            return None
        discs = context.moving
        tail = tail_count(discs, len(task.path_m))
        first, last = split_lines(task.lines, int(task.lines.piece.shape[1]) - tail)
        path = candidate.path_m
        lines = lines_with_violated(self._problem, self._ground.pieces, discs, task, path, first)
        if lines is not None and tail:
            lines = joined_lines(lines, last)
        if lines is not None:
            return replace(task, lines=lines)
        drive, motion = candidate.drive, task.motion
        if drive is None or motion is None:
            return None
        lines, stop = self._lines_about(context, path, drive, motion.shape.lines)
        motion = replace(motion, drive=drive, stop_lines=stop)
        return replace(task, path_m=path, lines=lines, motion=motion)

    def _lines_about(
        self, context: StepContext, path_m: Floats, drive: Drive | None, count: int
    ) -> tuple[SeparatingLines, SeparatingLines]:
        """Return `count` lines per segment of a guess (N, 2), and those of its braking segment.

        The last lines of each are for discs that move after the plan.
        """
        problem, discs, pieces = self._problem, context.moving, self._ground.pieces
        ends, tail = np.vstack([context.position_m, path_m]), tail_count(discs, len(path_m))
        reach = LINE_REACH_STEPS * problem.step_length_m
        end = rest = path_m[-1]
        if drive is not None:
            # Braking ends at the last of these points or slightly before.
            end, step_s = drive.states[-1, :2], problem.planner.step_s
            points = drive.dynamics.stop_points(tuple(drive.states[-1]), step_s)
            rest = np.array(points[-1] if points else end, dtype=np.float64)
        lines = lines_about(problem, pieces, discs, ends, count - tail)
        stop = separating_lines(pieces, end[None], rest[None], count - tail, reach)
        if not tail:
            return lines, stop
        motion = braked_motion(ends, drive, problem.planner.step_s)
        clearance = problem.constraints.clearance_m
        last, still = tail_lines(discs, motion, len(path_m), rest, clearance, tail, reach)
        return joined_lines(lines, last), joined_lines(stop, still)


@dataclass(frozen=True, eq=False)
class GoalRefinement:
    """Refinement of initial guesses for one step to a goal, in the order of the fallbacks."""

    nlp: PathNlp
    scene: Scene
    step: StepContext  # Planner's context, thresholds lowered by bounded slack
    scorer: Scorer
    cost: ReachCost
    start: GlobalStart
    ahead: Ahead
    lattice_objective: float
    budget: Budget

    def attempts(self, shifted_m: Floats | None) -> Iterator[Candidate]:
        """Yield candidate plans with their verdicts, first those refined from the best guess.

        If the shifted last plan costs less than the lattice path, it is the best guess.
        """
        start_m = self.start.path_m
        starts = [(start_m, Rung.RELAXED)]
        if not (self.start.margin_db < 0.0).any():
            problem = self.scorer.problem
            effort, fastest = problem.reach.effort_weight_s2_m2, problem.robots[0].speed_max_m_s
            step_m = cruising_speed_m_s(effort, fastest) * problem.planner.step_s - STEP_PAD_M
            retimed = retime(self.scorer.position_m, start_m, self.start.beyond_m, step_m)
            starts = [(retimed, Rung.PLAN), (start_m, Rung.COLD_RETRY)]
        if shifted_m is not None:
            shifted_m = self._drawn_on(shifted_m)
            margins = step_rows(self.step, shifted_m).margins_db(self.cost.power(shifted_m))
            relaxes = bool((margins < 0.0).any())
            if self.scorer.objective(shifted_m) < self.lattice_objective:
                starts.insert(0, (shifted_m, Rung.RELAXED if relaxes else Rung.PLAN))
            else:
                starts.append((shifted_m, Rung.RELAXED if relaxes else Rung.COLD_RETRY))
        for path_m, rung in starts:
            for candidate in self._from(path_m, rung):
                sooner = self._sooner(candidate)
                if sooner is not None:
                    yield sooner
                    candidate = replace(candidate, solve_s=0.0, iterations=0)
                yield candidate

    def _drawn_on(self, shifted_m: Floats) -> Floats:
        """Return the shifted last plan, whose last step moves towards the terminal waypoint."""
        problem, before = self.scorer.problem, shifted_m[-1]
        to_pivot = self.ahead.leading(before).position_m - before
        away, longest = float(np.linalg.norm(to_pivot)), problem.step_length_m - STEP_PAD_M
        goal_away = np.linalg.norm(before - np.asarray(problem.goal_m))
        if len(shifted_m) == 1 or away == 0.0 or goal_away <= problem.constraints.goal_radius_m:
            return shifted_m
        return np.vstack([shifted_m[:-1], before + to_pivot * min(1.0, longest / away)])

    def _sooner(self, candidate: Candidate) -> Candidate | None:
        """Return a candidate that drives the same path in fewer steps; None if there is none."""
        problem = self.scorer.problem
        path = np.vstack([self.scorer.position_m, candidate.path_m])
        away = np.linalg.norm(path - np.asarray(problem.goal_m), axis=1)
        there = np.nonzero(away <= problem.constraints.goal_radius_m)[0]
        arrives = there.size > 0 and there[0] >= 2
        if candidate.verdict is not Verdict.VERIFIED or not arrives or self.budget.spent:
            return None
        faster = retime(path[0], candidate.path_m, path[:0], problem.step_length_m - STEP_PAD_M)
        if np.linalg.norm(faster[there[0] - 2] - faster[-1]) > 0.0:
            return None
        begun, rows = perf_counter(), step_rows(self.step, faster)
        task = self._task(faster, rows)
        bound = tightened(task, rows, self.cost.power(faster), feasible=True)
        better = self._refined(task, bound, candidate.rung, begun)
        better = replace(
            better,
            solve_s=better.solve_s + candidate.solve_s,
            iterations=better.iterations + candidate.iterations,
        )
        is_better = better.objective < candidate.objective
        return better if better.verdict is Verdict.VERIFIED and is_better else None

    def _from(self, path_m: Floats, rung: Rung) -> Iterator[Candidate]:
        """Yield refinements of a path, each with separating lines for its predecessor's collisions.

        Steps that satisfy p_min in the guess keep it as a constraint; RELAXED frees the others.
        """
        if self.budget.spent:
            return
        rows = step_rows(self.step, path_m)
        task = self._task(path_m, rows)
        power = self.cost.power(path_m)
        bound = tightened(task, rows, power, feasible=True)
        free = (rows.margins_db(power) < 0.0) & (rung is Rung.RELAXED)
        bound[free] = -np.inf
        begun = perf_counter()
        for _ in range(REPAIRS):
            if self.budget.spent:
                return
            candidate = self._refined(task, bound, rung, begun)
            yield candidate
            begun = perf_counter()
            if not candidate.sound:
                scene = self.scorer.problem, self.scene.pieces, self.scorer.context.moving
                lines = lines_with_violated(*scene, task, candidate.path_m, task.lines)
                if lines is None:
                    return
                task = replace(task, lines=lines)
            power = None if candidate.found is None else candidate.found.power
            if power is None:
                return
            planned = Prediction(power.mean_db[1:], power.deviation_db[1:])
            lacking = np.where(free, 0.0, -rows.margins_db(planned))
            if candidate.sound and not (lacking > 0.0).any():
                return
            bound = bound + np.where(lacking > 0.0, lacking + MARGIN_PAD_DB, 0.0)

    def _refined(self, task: PathTask, bound: Floats, rung: Rung, begun_s: float) -> Candidate:
        """Return the candidate that refines a task under constraint bounds `bound`, verified."""
        point = polish_path(self.nlp, replace(task, bound=bound))
        spent_s, before = perf_counter() - begun_s, self.lattice_objective
        assessed = self.scorer.assessed(candidate_of(self.scorer, point, rung, before, spent_s))
        # The refined path may satisfy a constraint that the guess violates.
        met_after_all = rung is Rung.RELAXED and not assessed.relaxes
        return replace(assessed, rung=Rung.PLAN) if met_after_all else assessed

    def _task(self, path_m: Floats, rows: RuleRows) -> PathTask:
        """Return the optimisation problem that refines a guess `path_m`."""
        scorer, cost = self.scorer, self.cost
        problem, pivot = scorer.problem, self.ahead.leading(path_m[-1])
        ends = np.vstack([scorer.position_m, path_m])
        pieces, moving = self.scene.pieces, scorer.context.moving
        # A guess that waits at its end has arrived, at the goal or a waiting position. A refinement
        # over the whole horizon would never arrive.
        standing = np.linalg.norm(path_m - path_m[-1], axis=1) <= STANDSTILL_M
        arrival = len(path_m) - int(np.argmin(standing[::-1])) if not standing.all() else 0
        dwells = is_at_goal(problem, path_m[-1]) or arrival < len(path_m) - 1
        before, charged = cost.outage_charges(path_m)
        # The rate must cover the most expensive metre of the path, or driving it would not pay.
        metre_cost = max(pivot.metre_cost, float(cost.metre_costs(path_m).max()))
        predict_stages = stage_predictor(scorer.context.law, path_m, problem.planner.neighbours)

        def margins(positions_m: Floats) -> tuple[Derivatives, Derivatives]:
            power = predict_stages(positions_m)
            scores = scores_of(*power, cost.threshold_dbm)
            return margins_of(*power, rows.threshold_dbm, rows.quantile), scores

        value = GoalValue(
            start_m=scorer.position_m,
            pivot_m=pivot.position_m,
            effort_s_m2=problem.reach.effort_weight_s2_m2 / problem.planner.step_s,
            rate_s_m=cost.rate_s_m * metre_cost,
            outage=OutagePrice(cost.rate_s_m * cost.outage_price, before, charged),
            margins=margins,
        )
        return PathTask(
            start_m=scorer.position_m,
            path_m=path_m,
            lines=lines_about(problem, pieces, moving, ends, self.nlp.shape.lines),
            clearance_m=problem.constraints.clearance_m,
            step_length_m=problem.step_length_m,
            bounds_m=problem.workspace.bounds_m,
            evaluate=value,
            scale=1.0,
            arrival=arrival + 1 if dwells else None,
        )
