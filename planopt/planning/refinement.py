"""Refinement of initial guesses into verified candidates, for sums of terms and for goals."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction
from planopt.planning.candidates import Budget, Candidate, Scorer, solve_limit_s
from planopt.planning.certificate import RuleResult
from planopt.planning.plan import Rung, Termination
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
from planopt.planning.programme.path_rows import MotionShape, PathShape
from planopt.planning.proof.context import SEARCH_ERROR_DB, is_search_exact, obstacles_ahead
from planopt.planning.proof.rule import rule_of
from planopt.planning.scene import Ground
from planopt.planning.search.guess_search import Guess
from planopt.planning.tolerances import (
    MARGIN_TOLERANCE_DB,
)
from planopt.planning.values.context import StepContext, structure_of
from planopt.planning.values.local_value import local_value
from planopt.planning.values.rule_rows import (
    RuleRows,
    has_step_rows,
    has_sum_row,
    rows_again,
    rule_rows,
)
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive, braked_motion, rolled_out
from planopt.world.moving_discs import MovingDiscs
from planopt.world.separation import (
    PackedPieces,
    SeparatingLines,
    joined_lines,
    separating_lines,
    split_lines,
    tail_lines,
)


def lines_of_guess(
    problem: Problem,
    pieces: PackedPieces,
    discs: MovingDiscs,
    path_m: NDArray[np.float64],
    drive: Drive | None,
    count: int,
) -> tuple[SeparatingLines, SeparatingLines | None]:
    """Return `count` lines per segment of a guess (N + 1, 2), and lines for waiting after it.

    The second value is for discs that move after the plan; None if there are none.
    """
    horizon = len(path_m) - 1
    tail = tail_count(discs, horizon)
    lines = lines_about(problem, pieces, discs, path_m, count - tail)
    if not tail:
        return lines, None
    last, still = tail_lines(
        discs,
        braked_motion(path_m, drive, problem.planner.step_s),
        horizon,
        path_m[-1] if drive is None else standstill_m(problem, drive.states[-1]),
        problem.constraints.clearance_m,
        tail,
        LINE_REACH_STEPS * problem.step_length_m,
    )
    return joined_lines(lines, last), still


def candidate_of(
    scorer: Scorer,
    point: RefinedPath,
    rung: Rung,
    lattice_objective: float,
    solve_s: float,
    drive: Drive | None = None,
) -> Candidate:
    """Return the unverified candidate of a refined path."""
    path = point.path_m if drive is None else drive.positions_m[1:]
    return replace(
        scorer.candidate(path, rung, point.termination, drive),
        lattice_objective=lattice_objective,
        solve_s=solve_s,
        iterations=point.iterations,
        kkt_residual=point.kkt_residual,
        multipliers=point.multipliers,
    )


def motion_task(
    problem: Problem,
    ground: Ground,
    shape: MotionShape,
    drive: Drive,
    still: SeparatingLines | None,
) -> MotionTask:
    """Return the motion data of a refinement; `still` are separating lines at rest."""
    last = drive.states[-1]
    end = standstill_m(problem, last)[None]
    reach = LINE_REACH_STEPS * problem.step_length_m
    count = shape.lines - (0 if still is None else int(still.piece.shape[1]))
    lines = separating_lines(ground.pieces, last[None, :2], end, count, reach)
    return MotionTask(shape, drive, lines if still is None else joined_lines(lines, still))


def standstill_m(problem: Problem, state: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a resting position (2,) reached by braking from `state` (s,), or slightly beyond."""
    points = problem.robots[0].dynamics.stop_points(tuple(state), problem.planner.step_s)
    return np.array(points[-1] if points else state[:2], dtype=np.float64)


LOCAL_PAD_DB = 0.04
"""Margin added to the corrected bound: nine of ten returned paths have a smaller error (48
neighbours, 1,000 measurements, xi 4, beta 20 m)."""

GIVEN_UP_DB = 1e-3
"""Slack up to this value counts as solver tolerance."""

MISSING_DB_COST = 100.0
"""Cost per dB of slack in the solver if the bound cannot be met."""


def with_bounds(task: PathTask, context: StepContext, rows: RuleRows) -> PathTask:
    """Return the task with bounds that the guess meets; elsewhere with the least shortfall.

    The initial guess stays feasible. Bounded slack is available to all steps at its price.
    """
    if rows.weight is not None:
        return _with_total(task, context, rows)
    if not context.problem.constraints.asks_connection:
        return task
    wanted, local, exact = _wanted(task, context, rows)
    kept = exact >= -MARGIN_TOLERANCE_DB
    bound = np.where(kept, np.minimum(wanted, local), wanted)
    limit, weight = _slack(context, task.scale, np.where(np.isfinite(exact), -exact, 0.0))
    if not context.problem.constraints.rule.by_step:
        weight = weight if np.isinf(limit).any() else weight / max(int(rows.bounded.sum()), 1)
    return replace(
        task,
        bound_db=np.where(rows.bounded, bound, -np.inf),
        slack_limit_db=np.where(rows.bounded, limit, 0.0),
        slack_weight=weight,
    )


def lacks(
    context: StepContext, rows: RuleRows, point: RefinedPath, *, firmly: bool = False
) -> bool:
    """Return whether a returned path violates a bound that it meets by the local model.

    With `firmly` a margin below the error of the search's predictions counts as a violation, since
    its verification may be expensive.
    """
    if not len(point.slack_db) or not np.isfinite(point.path_m).all():
        return False
    power = context.predicted(point.path_m)
    if rows.weight is not None:
        # The shortfall of the sum in dB, to first order.
        short_db = (rows.total - rows.sum_of(power)) / _per_db(rows, power)
        missing = short_db > MARGIN_TOLERANCE_DB
        return bool(point.slack_db[0] <= GIVEN_UP_DB and missing)
    margins = rows.margins_db(power)
    unsure = firmly and not is_search_exact(context.posterior)
    least = SEARCH_ERROR_DB if unsure else -MARGIN_TOLERANCE_DB
    return bool((margins[point.slack_db <= GIVEN_UP_DB] < least).any())


def recentred(task: PathTask, context: StepContext, rows: RuleRows, point: RefinedPath) -> PathTask:
    """Return the task corrected by the local model's error at a returned path."""
    task = moved(task, context, rows, point.path_m)
    if rows.weight is not None:
        return replace(task, total_bound=_wanted_total(task, context, rows)[0])
    wanted = _wanted(task, context, rows)[0]
    return replace(task, bound_db=np.where(rows.bounded, wanted, -np.inf))


def moved(
    task: PathTask, context: StepContext, rows: RuleRows, path_m: NDArray[np.float64]
) -> PathTask:
    """Return the task for another path (N, 2), with the local channel near it."""
    return replace(task, path_m=path_m, evaluate=local_value(context, path_m, rows))


def _with_total(task: PathTask, context: StepContext, rows: RuleRows) -> PathTask:
    power = context.predicted(task.path_m)
    task = replace(task, total_per_db=_per_db(rows, power))
    wanted, local = _wanted_total(task, context, rows)
    short_db = (rows.total - rows.sum_of(power)) / task.total_per_db
    limit, weight = _slack(context, task.scale, np.array([short_db]))
    return replace(
        task,
        total_bound=wanted if short_db > 0.0 else min(wanted, local),
        slack_limit_db=limit,
        slack_weight=weight,
    )


def _slack(
    context: StepContext, scale: float, missing_db: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Return the limit of each row's slack, and the slack's cost per dB in the solver.

    The limit is infinite for rows that the guess violates beyond the slack; slack then costs more.
    """
    rule = context.problem.constraints.rule
    allowed = rule.slack_max_db or 0.0
    limit = np.where(missing_db <= allowed + MARGIN_TOLERANCE_DB, allowed, np.inf)
    if np.isinf(limit).any() or allowed == 0.0:
        return limit, MISSING_DB_COST
    return limit, scale * rule.slack_price


def _wanted(
    task: PathTask, context: StepContext, rows: RuleRows
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the required local margins, and the guess's local and exact margins.

    The requirement includes the local model's error at the guess.
    """
    local, exact = margins_at(task, task.path_m), rows.margins_db(context.predicted(task.path_m))
    return LOCAL_PAD_DB + local - exact, local, exact


def margins_at(task: PathTask, path_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the margins (N,) of a path by the local model of a bounded task."""
    margins = task.evaluate(path_m).margins
    if margins is None:
        raise AssertionError("a bounded problem has margins")
    return margins.value


def _wanted_total(task: PathTask, context: StepContext, rows: RuleRows) -> tuple[float, float]:
    """Return the required local sum, and the guess's local sum."""
    total = task.evaluate(task.path_m).total
    if total is None:
        raise AssertionError("a bounded sum is there")
    off = total.value - rows.sum_of(context.predicted(task.path_m))
    return rows.total + off + LOCAL_PAD_DB * task.total_per_db, total.value


def _per_db(rows: RuleRows, power: Prediction) -> float:
    """Return the derivative of the sum by the threshold reduction in dB; not zero."""
    if rows.weight is None:
        raise AssertionError("no sum is bounded")
    score = (power.mean_db - rows.threshold_dbm) / power.deviation_db
    density = np.exp(-0.5 * score**2) / (np.sqrt(2.0 * np.pi) * power.deviation_db)
    return max(float(rows.weight @ density), 1e-3 * float(rows.weight.max(initial=0.0)), 1e-9)


LINES_PER_SEGMENT = 2
"""Number of convex pieces that each segment is separated from; the verifier checks all."""

ALLOCATIONS = 6
"""Maximum number of refinements that redistribute the total risk over the steps."""

VALUE_IN_SOLVER = 10.0
"""Scaled value of the guess in the solver, whose tolerances are absolute."""

RETURNED = frozenset((Termination.CONVERGED, Termination.ACCEPTABLE))
"""Terminations after which another solve may start from the returned point."""


class GuessRefinement:
    """Refinement of guesses for sums of terms; caches the built solvers."""

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem = problem
        self._ground = ground
        self._built: dict[int, PathNlp] = {}
        self._nlp_for(obstacles_ahead(problem, 0))

    def _nlp_for(self, discs: MovingDiscs) -> PathNlp:
        """Return the programme with lines for these moving discs, built on first use."""
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
        """Return the verified candidates of a guess; none once the budget is spent."""
        budget = Budget() if budget is None else budget
        problem, moving = self._problem, context.moving
        nlp = self._nlp_for(moving)
        if budget.spent:
            return []
        rows = rule_rows(context, guess.path_m)
        evaluate = local_value(context, guess.path_m, rows)
        ends = np.vstack([context.position_m, guess.path_m])
        pieces = self._ground.pieces
        lines, still = lines_of_guess(problem, pieces, moving, ends, guess.drive, nlp.shape.lines)
        task = PathTask(
            start_m=context.position_m,
            path_m=guess.path_m,
            lines=lines,
            clearance_m=problem.constraints.clearance_m,
            step_length_m=problem.step_length_m,
            bounds_m=problem.workspace.bounds_m,
            evaluate=evaluate,
            scale=VALUE_IN_SOLVER / (abs(_counted(problem, guess)) or VALUE_IN_SOLVER),
        )
        if nlp.shape.motion is not None and guess.drive is not None:
            motion = motion_task(problem, self._ground, nlp.shape.motion, guess.drive, still)
            task = replace(task, motion=motion, charge=guess.charge)
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
            spent_s = perf_counter() - begun
            lattice = scorer.sense * guess.value
            candidate = candidate_of(scorer, point, rung, lattice, spent_s, drive)
            if lacks(context, rows, point, firmly=attempt == 0):
                # The local model was inaccurate, and a verification would be expensive.
                found.append(candidate)
                if budget.spent or point.termination not in RETURNED:
                    return found
                task = _driven_from(recentred(task, context, rows, point), drive)
                continue
            improvable = guess.clear and guess.missing_db == 0.0 and not allocations
            if improvable and scorer.score(candidate) < guess.value:
                # The guess itself will be verified instead.
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
            task = _driven_from(moved(task, context, rows, candidate.path_m), drive)
            task = with_bounds(task, context, rows)
        return found

    def _repaired(
        self, task: PathTask, context: StepContext, candidate: Candidate
    ) -> PathTask | None:
        """Return the task with lines for the path's violations; None if there are none."""
        if candidate.sound or not np.isfinite(candidate.path_m).all():
            return None
        discs = context.moving
        tail = tail_count(discs, len(task.path_m))
        first, last = split_lines(task.lines, int(task.lines.piece.shape[1]) - tail)
        lines = lines_with_violated(
            self._problem,
            self._ground.pieces,
            discs,
            first,
            np.vstack([task.start_m, task.path_m]),
            np.vstack([task.start_m, candidate.path_m]),
        )
        if lines is not None and tail:
            lines = joined_lines(lines, last)
        if lines is not None:
            return replace(task, lines=lines)
        if candidate.drive is not None:
            return self._about(task, context, candidate.path_m, candidate.drive)
        return None

    def _about(
        self, task: PathTask, context: StepContext, path_m: NDArray[np.float64], drive: Drive
    ) -> PathTask:
        """Return the task that starts from a drive, with lines about its curve and braking path."""
        if task.motion is None:
            raise AssertionError("a single integrator has no drive")
        problem = self._problem
        ends, count = np.vstack([task.start_m, path_m]), task.motion.shape.lines
        lines, still = lines_of_guess(
            problem, self._ground.pieces, context.moving, ends, drive, count
        )
        motion = motion_task(problem, self._ground, task.motion.shape, drive, still)
        return replace(task, path_m=path_m, lines=lines, motion=motion)


def _counted(problem: Problem, guess: Guess) -> float:
    """Return the value that scales the solver's objective; for a goal, the horizon in seconds."""
    return guess.value if guess.charge is None else problem.planner.step_s * len(guess.path_m)


def _driven_from(task: PathTask, drive: Drive | None) -> PathTask:
    """Return the task that starts from a drive; unchanged for the single integrator."""
    if task.motion is None or drive is None:
        return task
    return replace(task, motion=replace(task.motion, drive=drive))
