"""Refinement of initial guesses into verified candidates, for sums of terms and for goals."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats, Mask
from planopt.channel.kriging import Prediction
from planopt.objectives.stage_power import scores_of, stage_predictor
from planopt.planning.candidates import Budget, Candidate, Scorer, solve_limit_s
from planopt.planning.certificate import RuleResult
from planopt.planning.plan import Pivot, Rung, Termination
from planopt.planning.programme.goal_value import (
    EvaluatePath,
    Evaluation,
    GoalCharge,
    LocalModel,
    PricedCharge,
    margins_of,
    remembering,
)
from planopt.planning.programme.path_nlp import GOAL, METHODS, PathNlp, build_path_nlp, near_start
from planopt.planning.programme.solver import (
    Bounds,
    MotionShape,
    NlpPoint,
    PathShape,
    kkt_residual,
    motion_rows,
)
from planopt.planning.proof.motion import is_at_goal
from planopt.planning.proof.rule import SEARCH_ERROR_DB, is_search_exact, obstacles_ahead, rule_of
from planopt.planning.scene import Ground
from planopt.planning.search.guess_search import Guess
from planopt.planning.tolerances import (
    CLEARANCE_PAD_M,
    CLEARANCE_TOLERANCE_M,
    MARGIN_TOLERANCE_DB,
    STANDSTILL_M,
    STEP_PAD_M,
)
from planopt.planning.values.context import StepContext, structure_of
from planopt.planning.values.local_value import local_value
from planopt.planning.values.objective_value import (
    ReachCost,
    RuleRows,
    has_step_rows,
    has_sum_row,
    rows_again,
    rule_rows,
    step_rows,
)
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive, braked_motion, rolled_out
from planopt.world.motion import MovingDiscs, path_distances_m
from planopt.world.separation import (
    PackedPieces,
    SeparatingLines,
    joined_lines,
    lines_for,
    moving_lines,
    separating_lines,
    split_lines,
    tail_lines,
)


@dataclass(frozen=True, eq=False)
class MotionTask:
    """Initial guess of a robot with dynamics, and separating lines for its braking path."""

    shape: MotionShape
    drive: Drive  # Drive along the guess, from the robot's state
    stop_lines: SeparatingLines  # Separating lines of the subsequent braking segment


@dataclass(frozen=True)
class RefinedPath:
    """Path that a solver returned, with multipliers and status, not yet verified."""

    path_m: Floats  # (N, 2)
    slack_db: Floats  # (N,) shortfall in dB
    termination: Termination
    iterations: int
    kkt_residual: float  # KKT residual of the unscaled programme
    # By row: speed (N,), line_end (N, lines), line_start (N - 1, lines), connectivity (N,)
    multipliers: dict[str, Floats]
    inputs: Floats | None = None  # (N, m) inputs of a robot with dynamics


@dataclass(frozen=True)
class PathTask:
    """Optimisation problem that refines one initial guess."""

    start_m: Floats  # (2,) the robot's position
    path_m: Floats  # (N, 2) the guess
    lines: SeparatingLines  # Separating lines of the guess's N segments
    clearance_m: float
    step_length_m: float
    bounds_m: tuple[float, float, float, float]  # The workspace (x_min, y_min, x_max, y_max)
    evaluate: EvaluatePath  # Maps a path to its value and margins
    scale: float  # Factor of the value, as solver tolerances are absolute
    # (N,) lower bounds of the margins in dB, or (1,) of their sum; None without connectivity rows
    bound: Floats | None = None
    per_db: float = 1.0  # Change of a row per dB of slack
    slack_limit_db: Floats | None = None  # Upper bounds of the slack; 0 if hard
    slack_weight: float = 0.0  # Cost per dB of slack
    motion: MotionTask | None = None  # None for the single integrator
    charge: GoalCharge | PricedCharge | None = None  # Goal cost; None without a goal
    held: Mask | None = None  # (N,) positions of the guess that the refined path keeps


def polish_path(nlp: PathNlp, task: PathTask) -> RefinedPath:
    """Return the solution of the nonlinear programme that is found from the task's guess."""
    shape, motion = nlp.shape, task.motion
    n, lines = shape.horizon, shape.lines
    bound = np.zeros(0) if task.bound is None else task.bound
    slack_limit = np.zeros(shape.slacks) if task.slack_limit_db is None else task.slack_limit_db
    pad = 0.0 if shape.motion is None else shape.motion.dynamics.hull_pad_m(shape.motion.step_s)
    kept = task.clearance_m + pad + CLEARANCE_PAD_M
    line = task.lines.rows(kept).ravel()
    longest = task.step_length_m - STEP_PAD_M if shape.motion is None else np.inf
    driven, own = np.zeros(0), np.zeros(0)
    motion_bounds = np.zeros(0), np.zeros(0)
    if motion is not None:
        driven = np.hstack([motion.drive.states[1:, 2:], motion.drive.inputs]).ravel()
        stop, states = motion.stop_lines.rows(kept).ravel(), motion.drive.states
        own = np.concatenate([states[0, 2:], stop])
        every = np.concatenate([line, stop])
        rows = motion_rows(motion.shape, states[1:, :2].ravel(), driven, tuple(states[0]), every)
        motion_bounds = rows.bounds(task.bounds_m)
    x_min, y_min, x_max, y_max = task.bounds_m
    lower, upper = np.tile([x_min, y_min], n), np.tile([x_max, y_max], n)
    if task.held is not None:
        held = np.repeat(task.held, 2)
        lower[held] = upper[held] = task.path_m.ravel()[held]
    free = np.full(len(driven), np.inf)
    variables = Bounds(
        np.concatenate([lower, np.zeros(shape.slacks), -free]),
        np.concatenate([upper, slack_limit, free]),
    )
    apart, none = np.zeros(n * 2 * lines - lines), np.full(n, np.inf)
    row_bounds = Bounds(
        np.concatenate([-none, apart, motion_bounds[0], bound]),
        np.concatenate(
            [np.full(n, longest**2), apart + np.inf, motion_bounds[1], np.full(len(bound), np.inf)]
        ),
    )
    head = np.array([*task.start_m, task.scale, task.slack_weight, task.per_db])
    charge = np.zeros(0) if task.charge is None else task.charge.numbers
    parameters = np.concatenate([head, line, own, charge])
    nlp.source.evaluate = task.evaluate
    missing = np.zeros(0)
    if shape.slacks:
        missing = np.maximum(bound - task.evaluate(task.path_m).rows, 0.0) / task.per_db
    guess = np.concatenate([task.path_m.ravel(), np.minimum(missing, slack_limit), driven])
    point = nlp.solve(guess, parameters, variables, row_bounds)
    slack, driven = np.split(point.others, [shape.slacks])
    inputs = None
    if motion is not None:
        inputs = driven.reshape(n, motion.shape.per_step)[:, motion.shape.rest :]
    return RefinedPath(
        path_m=point.positions_m,
        slack_db=slack,
        termination=point.termination,
        iterations=point.iterations,
        kkt_residual=_residual(nlp, point, parameters, variables, row_bounds),
        multipliers=_named_multipliers(point.row_multipliers, shape),
        inputs=inputs,
    )


def _residual(
    nlp: PathNlp, point: NlpPoint, parameters: Floats, variable_bounds: Bounds, row_bounds: Bounds
) -> float:
    """Return the KKT residual at a solver's point; infinite if it is not finite."""
    at = np.concatenate([point.positions_m.ravel(), point.others])
    if not (np.isfinite(at).all() and np.isfinite(point.row_multipliers).all()):
        return float("inf")
    nlp.source(point.positions_m)  # CasADi would hide exceptions of user-defined terms.
    gradient, jacobian = nlp.functions.slopes(at, parameters)
    return kkt_residual(
        gradient,
        jacobian,
        nlp.functions.rows(at, parameters),
        row_bounds,
        point.row_multipliers,
        at,
        variable_bounds,
        point.variable_multipliers,
    )


def _named_multipliers(rows: Floats, shape: PathShape) -> dict[str, Floats]:
    """Return the multipliers of the geometric and connectivity rows by name."""
    n, lines = shape.horizon, shape.lines
    speed, line_end, line_start = np.split(
        rows[: n * (1 + 2 * lines) - lines], [n, n * (1 + lines)]
    )
    found = {
        "speed": speed,
        "line_end": line_end.reshape(n, lines),
        "line_start": line_start.reshape(n - 1, lines),
    }
    return found | ({"connectivity": rows[len(rows) - shape.bounds :]} if shape.bounds else {})


LINE_REACH_STEPS = 2.0
"""Distance, in longest steps, beyond which a convex piece gets no line for a segment."""
REPAIRS = 3
"""Maximum number of refinements of a guess; each adds lines for the violations found before."""
MOVING_LINES = 3
"""Maximum number of moving discs, nearest first, with a separating line for a segment."""


def moving_count(discs: MovingDiscs) -> int:
    """Return the number of separating lines that each segment reserves for moving discs."""
    return min(MOVING_LINES, len(discs))


def lines_about(
    problem: Problem, pieces: PackedPieces, discs: MovingDiscs, path_m: Floats, count: int
) -> SeparatingLines:
    """Return `count` separating lines per segment, for nearby obstacle pieces and moving discs."""
    # Shapes: path_m (N + 1, 2), the robot's position, then the guess.
    reach = LINE_REACH_STEPS * problem.step_length_m
    standing = count - moving_count(discs)
    lines = separating_lines(pieces, path_m[:-1], path_m[1:], standing, reach)
    return joined_lines(lines, _moving_lines(problem, discs, path_m)) if len(discs) else lines


def lines_with_violated(
    problem: Problem,
    pieces: PackedPieces,
    discs: MovingDiscs,
    task: PathTask,
    found_m: Floats,  # (N, 2)
    lines: SeparatingLines,
) -> SeparatingLines | None:
    """Return `lines` with new lines for obstacles that a path hits; None if it hits none."""
    guess_m, path_m = (np.vstack([task.start_m, each]) for each in (task.path_m, found_m))
    standing = lines.piece.shape[1] - moving_count(discs)
    chosen = lines.piece[:, :standing].copy()
    now = separating_lines(pieces, path_m[:-1], path_m[1:], standing, problem.step_length_m)
    changed = False
    limit = problem.constraints.clearance_m - CLEARANCE_TOLERANCE_M
    for k, j in zip(*np.nonzero(now.gaps < limit), strict=True):
        violated = now.piece[k, j]
        if violated >= 0 and violated not in chosen[k]:
            chosen[k, -1] = violated
            changed = True
    needed = _discs_met(discs, lines.piece[:, standing:], path_m)
    if not (changed or needed.any()):
        return None
    again = lines_for(pieces, guess_m[:-1], guess_m[1:], chosen)
    if not len(discs):
        return again
    return joined_lines(again, _moving_lines(problem, discs, guess_m, needed))


def _moving_lines(
    problem: Problem, discs: MovingDiscs, path_m: Floats, needed: Mask | None = None
) -> SeparatingLines:
    """Return separating lines for the nearest moving discs and for all discs in `needed`."""
    reach = LINE_REACH_STEPS * problem.step_length_m
    # The pad covers the robot's uncertain position within a step.
    pad_m = problem.robots[0].dynamics.timed_pad_m(problem.planner.step_s)
    clearance, count = problem.constraints.clearance_m, moving_count(discs)
    return moving_lines(discs, path_m, clearance, count, reach, needed, pad_m)


def _discs_met(discs: MovingDiscs, chosen: NDArray[np.int64], path_m: Floats) -> Mask:
    """Return a mask (m, N) of collisions with discs, by step, that have no separating line."""
    if not len(discs):
        return np.zeros((0, len(path_m) - 1), dtype=np.bool_)
    apart = discs.apart_m[:, : len(path_m) - 1]
    near = path_distances_m(discs, path_m) < apart - CLEARANCE_TOLERANCE_M
    numbers = np.arange(len(discs))[:, None, None]
    return near & ~(chosen == numbers).any(axis=2)


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
GIVEN_UP_DB = 1e-3  # Slack in dB that counts as solver tolerance
MISSING_DB_COST = 100.0
"""Cost per dB of slack in the solver if the guess violates the constraint beyond the slack."""


def tightened(task: PathTask, rows: RuleRows, power: Prediction, *, feasible: bool) -> Floats:
    """Return a task's constraint bounds, tightened by the local model's error at the guess."""
    # With `feasible`, constraints that the path satisfies by the exact `power` stay feasible.
    local, per_db = task.evaluate(task.path_m).rows, rows.per_db(power)
    missing = rows.total - rows.achieved(power)
    bound = missing + local + LOCAL_PAD_DB * per_db
    kept = feasible & (missing <= MARGIN_TOLERANCE_DB * per_db)
    return np.where(kept, np.minimum(bound, local), bound)


def with_bounds(task: PathTask, context: StepContext, rows: RuleRows) -> PathTask:
    """Return the task with connectivity constraints, relaxed where the guess violates them."""
    # A row that the guess violates by more has unlimited slack at a higher price.
    constraints = context.problem.constraints
    if not constraints.requires_connection:
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
    context: StepContext, power: Prediction, rows: RuleRows, held: Mask, *, firmly: bool = False
) -> bool:
    """Return whether predicted powers violate a constraint row that the mask `held` selects."""
    # With `firmly`, margins below the search error count: verification may be expensive.
    unsure = firmly and rows.weight is None and not is_search_exact(context.posterior)
    most = -SEARCH_ERROR_DB if unsure else MARGIN_TOLERANCE_DB
    return bool((rows.shortfall_db(power)[held] > most).any())


def moved(task: PathTask, model: LocalModel, path_m: Floats, drive: Drive | None) -> PathTask:
    """Return the task for a new guess `path_m` (N, 2) and its local model and goal cost."""
    motion = task.motion
    if motion is not None and drive is not None:
        motion = replace(motion, drive=drive)
    return replace(task, path_m=path_m, evaluate=model[0], charge=model[1], motion=motion)


def goal_value(
    cost: ReachCost,
    leading: Callable[[Floats], Pivot],  # Maps a path's end (2,) to an unreachable pivot
    context: StepContext,
    path_m: Floats,
    rows: RuleRows,
) -> LocalModel:
    """Return margins and scores near the path (N, 2) of a single integrator, and its goal cost."""
    pivot, effort = leading(path_m[-1]), cost.problem.reach.effort_weight_s2_m2
    before, charged = cost.outage_charges(path_m)
    # The rate must cover the most expensive metre of the path, or driving it would not pay.
    metre_cost = max(pivot.metre_cost, float(cost.metre_costs(path_m).max()))
    predict_stages = stage_predictor(context.law, path_m, cost.problem.planner.neighbours)

    def evaluate(positions_m: Floats) -> Evaluation:
        power = predict_stages(positions_m)
        margins = margins_of(*power, rows.threshold_dbm, rows.quantile)
        return Evaluation(None, margins, scores=scores_of(*power, cost.threshold_dbm))

    return remembering(evaluate), PricedCharge(
        pivot_m=pivot.position_m,
        effort_s_m2=effort / cost.problem.planner.step_s,
        rate_s_m=cost.rate_s_m * metre_cost,
        price_s_m=cost.rate_s_m * cost.outage_price,
        share_before=before,
        charged=charged,
    )


def arrived_steps(problem: Problem, path_m: Floats) -> Mask:
    """Return a mask (N,) of the steps after which a path (N, 2) waits at its goal."""
    # A guess that waits at its end has arrived; over the whole horizon it never would.
    standing = np.linalg.norm(path_m - path_m[-1], axis=1) <= STANDSTILL_M
    arrival = len(path_m) - int(np.argmin(standing[::-1])) if not standing.all() else 0
    dwells = is_at_goal(problem, path_m[-1]) or arrival < len(path_m) - 1
    return dwells & (np.arange(len(path_m)) >= arrival)


LINES_PER_SEGMENT, GOAL_LINES = 2, 4
"""Numbers of separating lines per segment, for sums of terms and to a goal."""
ALLOCATIONS = 6
"""Maximum number of refinements, each of which redistributes the total risk over the steps."""
VALUE_IN_SOLVER = 10.0
"""Value to which the guess's objective is scaled, since solver tolerances are absolute."""
RETURNED = frozenset((Termination.CONVERGED, Termination.ACCEPTABLE))
"""Terminations whose point may be the guess of another solve."""


class Refinement:
    """Refinement of guesses for goals and for sums of terms; it caches the built solvers."""

    def __init__(self, problem: Problem, ground: Ground, others: int = 0) -> None:
        self._problem = problem
        self._ground = ground
        self._to_goal = problem.has_goal and problem.robots[0].moves_freely
        self._moving = min(len(problem.workspace.moving) + others, MOVING_LINES)
        self._built: dict[int, PathNlp] = {}
        self._nlp_for(obstacles_ahead(problem, 0))

    def _tail(self, discs: MovingDiscs) -> int:
        """Return the number of lines for discs that move after the plan's end; 0 for goal plans."""
        ends = self._to_goal or discs.steps <= self._problem.planner.horizon
        return 0 if ends else moving_count(discs)

    def _nlp_for(self, discs: MovingDiscs) -> PathNlp:
        """Return the solver with enough lines for these moving discs, built on first use."""
        problem, settings, robot = self._problem, self._problem.planner, self._problem.robots[0]
        lines = max(self._moving, moving_count(discs)) + self._tail(discs)
        lines += GOAL_LINES if self._to_goal else LINES_PER_SEGMENT
        if lines not in self._built:
            motion = None
            if not robot.moves_freely:
                motion = MotionShape(robot.dynamics, settings.step_s, settings.horizon, lines)
            shape = PathShape(
                settings.horizon,
                lines,
                structure_of(problem),
                self._to_goal or has_step_rows(problem),
                has_sum_row(problem) and not self._to_goal,
                motion,
                charged=problem.has_goal,
                valued=bool(problem.terms),
                slacked=not self._to_goal,
            )
            self._built[lines] = build_path_nlp(
                shape,
                METHODS[settings.name],
                solve_limit_s(problem),
                GOAL if self._to_goal else near_start(shape, until_settled=True),
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
        """Refine a guess and verify the candidates; return none once the budget is spent."""
        budget = Budget() if budget is None else budget
        problem, to_goal = self._problem, self._to_goal
        nlp = self._nlp_for(context.moving)
        if budget.spent:
            return []
        rows = (step_rows if to_goal else rule_rows)(context, guess.path_m)
        predicted = context.power if to_goal else context.predicted
        lines, stop = self._lines_about(context, guess.path_m, guess.drive, nlp.shape.lines)
        motion = None
        if nlp.shape.motion is not None and guess.drive is not None:
            motion = MotionTask(nlp.shape.motion, guess.drive, stop)
        # A goal's cost is scaled by the horizon in seconds.
        value = guess.value
        if guess.charge is not None:
            value = problem.planner.step_s * len(guess.path_m)

        def near(path_m: Floats, rows: RuleRows) -> LocalModel:
            if guess.near is not None:
                return guess.near(context, path_m, rows)
            return local_value(context, path_m, rows), guess.charge

        evaluate, charge = near(guess.path_m, rows)
        task = PathTask(
            start_m=context.position_m,
            path_m=guess.path_m,
            lines=lines,
            clearance_m=problem.constraints.clearance_m,
            step_length_m=problem.step_length_m,
            bounds_m=problem.workspace.bounds_m,
            evaluate=evaluate,
            scale=1.0 if to_goal else VALUE_IN_SOLVER / (abs(value) or VALUE_IN_SOLVER),
            motion=motion,
            charge=charge,
            held=arrived_steps(problem, guess.path_m) if to_goal else guess.held,
        )
        if to_goal:
            power = predicted(guess.path_m)
            # Steps that satisfy p_min in the guess keep it; RELAXED frees the others.
            freed = (rows.margins_db(power) < 0.0) & (rung is Rung.RELAXED)
            bound = tightened(task, rows, power, feasible=True)
            task = replace(task, bound=np.where(freed, -np.inf, bound))
        else:
            task = with_bounds(task, context, rows)
        correlates = rule_of(problem).correlates(problem.constraints.p_min)
        allocations = ALLOCATIONS if correlates and not to_goal else 0
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
            bound = np.zeros(0) if task.bound is None else task.bound
            held = point.slack_db <= GIVEN_UP_DB if nlp.shape.slacks else np.isfinite(bound)
            if held.any() and np.isfinite(point.path_m).all():
                power = predicted(point.path_m)
                if lacks(context, power, rows, held, firmly=attempt == 0):
                    # The local model was inaccurate, and verification is expensive.
                    found.append(candidate)
                    if budget.spent or point.termination not in RETURNED:
                        return found
                    # The next solve corrects the local model by its error at the returned path.
                    task = moved(task, near(point.path_m, rows), point.path_m, drive)
                    again = tightened(task, rows, power, feasible=False)
                    task = replace(task, bound=np.where(np.isneginf(bound), -np.inf, again))
                    continue
            improvable = guess.clear and guess.missing_db == 0.0 and not allocations
            if improvable and scorer.score(candidate) < guess.value:
                # The guess itself is verified instead.
                return [*found, candidate]
            candidate = scorer.assessed(candidate)
            if candidate.relaxes or rung is Rung.RELAXED:
                now = Rung.RELAXED if candidate.relaxes else Rung.PLAN
                candidate = replace(candidate, rung=now)
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
            task = moved(task, near(candidate.path_m, rows), candidate.path_m, drive)
            task = with_bounds(task, context, rows)
        return found

    def _repaired(
        self, task: PathTask, context: StepContext, candidate: Candidate
    ) -> PathTask | None:
        """Return the task with new separating lines at collisions; None without collisions."""
        if candidate.sound or not np.isfinite(candidate.path_m).all():
            return None
        discs, tail = context.moving, self._tail(context.moving)
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
        """Return `count` lines per segment of a guess (N, 2), and lines for its braking segment."""
        # The last lines of each are for discs that move after the plan.
        problem, discs, pieces = self._problem, context.moving, self._ground.pieces
        ends, tail = np.vstack([context.position_m, path_m]), self._tail(discs)
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
