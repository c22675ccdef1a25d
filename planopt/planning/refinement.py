"""Refinement of initial guesses into verified candidates, for sums of terms and for goals."""

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.channel.prediction import Prediction
from planopt.objectives.stage_power import scores_of, stage_predictor
from planopt.planning.candidates import Budget, Candidate, Scorer, solve_limit_s
from planopt.planning.certificate import RuleResult
from planopt.planning.plan import Pivot, Rung, Termination
from planopt.planning.programme.goal_value import EvaluatePath, GoalValue, OutagePrice, margins_of
from planopt.planning.programme.path_nlp import GOAL, METHODS, PathNlp, build_path_nlp, near_start
from planopt.planning.programme.path_polish import (
    LINE_REACH_STEPS,
    MOVING_LINES,
    REPAIRS,
    MotionTask,
    PathTask,
    RefinedPath,
    lines_about,
    lines_with_violated,
    moving_count,
    polish_path,
)
from planopt.planning.programme.solver import MotionShape, PathShape
from planopt.planning.proof.context import SEARCH_ERROR_DB, is_search_exact, obstacles_ahead
from planopt.planning.proof.motion import is_at_goal
from planopt.planning.proof.rule import rule_of
from planopt.planning.scene import Ground
from planopt.planning.search.guess_search import Guess
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB, STANDSTILL_M
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


def moved(task: PathTask, evaluate: EvaluatePath, path_m: Floats, drive: Drive | None) -> PathTask:
    """Return the task for a new guess `path_m` (N, 2) and its local model `evaluate`."""
    motion = task.motion
    if motion is not None and drive is not None:
        motion = replace(motion, drive=drive)
    return replace(task, path_m=path_m, evaluate=evaluate, motion=motion)


def goal_value(
    cost: ReachCost,
    leading: Callable[[Floats], Pivot],  # Maps a path's end (2,) to an unreachable pivot
    context: StepContext,
    path_m: Floats,
    rows: RuleRows,
) -> GoalValue:
    """Return the local model of a goal's cost around the path (N, 2) of a single integrator."""
    pivot, effort = leading(path_m[-1]), cost.problem.reach.effort_weight_s2_m2
    before, charged = cost.outage_charges(path_m)
    # The rate must cover the most expensive metre of the path, or driving it would not pay.
    metre_cost = max(pivot.metre_cost, float(cost.metre_costs(path_m).max()))
    predict_stages = stage_predictor(context.law, path_m, cost.problem.planner.neighbours)

    def margins(positions_m: Floats) -> tuple[Derivatives, Derivatives]:
        power = predict_stages(positions_m)
        scores = scores_of(*power, cost.threshold_dbm)
        return margins_of(*power, rows.threshold_dbm, rows.quantile), scores

    return GoalValue(
        start_m=cost.position_m,
        pivot_m=pivot.position_m,
        effort_s_m2=effort / cost.problem.planner.step_s,
        rate_s_m=cost.rate_s_m * metre_cost,
        outage=OutagePrice(cost.rate_s_m * cost.outage_price, before, charged),
        margins=margins,
    )


def arrival_step(problem: Problem, path_m: Floats) -> int | None:
    """Return the step (1..N) after which a path (N, 2) waits at its goal; None if it never does."""
    # A guess that waits at its end has arrived; over the whole horizon it never would.
    standing = np.linalg.norm(path_m - path_m[-1], axis=1) <= STANDSTILL_M
    arrival = len(path_m) - int(np.argmin(standing[::-1])) if not standing.all() else 0
    dwells = is_at_goal(problem, path_m[-1]) or arrival < len(path_m) - 1
    return arrival + 1 if dwells else None


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
        # The programme of a robot with dynamics contains the goal cost itself.
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
            if self._to_goal:
                shape = PathShape(settings.horizon, lines, "chain", bounded=True, slacked=False)
            else:
                motion = None
                if not robot.moves_freely:
                    motion = MotionShape(robot.dynamics, settings.step_s, settings.horizon, lines)
                shape = PathShape(
                    settings.horizon,
                    lines,
                    structure_of(problem),
                    has_step_rows(problem),
                    has_sum_row(problem),
                    motion,
                    charged=problem.has_goal,
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
        near = guess.near or local_value
        task = PathTask(
            start_m=context.position_m,
            path_m=guess.path_m,
            lines=lines,
            clearance_m=problem.constraints.clearance_m,
            step_length_m=problem.step_length_m,
            bounds_m=problem.workspace.bounds_m,
            evaluate=near(context, guess.path_m, rows),
            scale=1.0 if to_goal else VALUE_IN_SOLVER / (abs(value) or VALUE_IN_SOLVER),
            motion=motion,
            charge=guess.charge,
            arrival=arrival_step(problem, guess.path_m) if to_goal else None,
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
                    task = moved(task, near(context, point.path_m, rows), point.path_m, drive)
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
            evaluate = near(context, candidate.path_m, rows)
            task = moved(task, evaluate, candidate.path_m, drive)
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
