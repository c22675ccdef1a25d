"""Refinement of initial guesses into verified candidates, for sums of terms and for goals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, bound_quantile
from planopt.objectives.reach import cruising_speed_m_s
from planopt.objectives.stage_power import scores_of
from planopt.planning.candidates import Budget, Candidate, Scorer, solve_limit_s
from planopt.planning.certificate import RuleResult
from planopt.planning.driven import motion_shape, motion_task, refined_drive, standstill_m
from planopt.planning.plan import Rung, Termination, Verdict
from planopt.planning.programme.clearance_lines import (
    LINE_REACH_STEPS,
    REPAIRS,
    lines_about,
    lines_with_violated,
    moving_count,
    tail_count,
)
from planopt.planning.programme.evaluation import margins_of
from planopt.planning.programme.goal_value import GoalValue, OutagePrice
from planopt.planning.programme.path_nlp import METHODS, PathNlp, build_path_nlp, near_start
from planopt.planning.programme.path_polish import PathTask, RefinedPath, polish_path
from planopt.planning.programme.path_rows import PathShape
from planopt.planning.proof.context import obstacles_ahead
from planopt.planning.proof.rule import rule_of
from planopt.planning.rule_bounds import lacks, moved, recentred, with_bounds
from planopt.planning.scene import Ground, Scene
from planopt.planning.search.global_search import GlobalStart
from planopt.planning.search.guess_search import Guess
from planopt.planning.search.pivot import Ahead
from planopt.planning.search.taut_path import retime
from planopt.planning.tolerances import (
    MARGIN_PAD_DB,
    STANDSTILL_M,
    STEP_PAD_M,
)
from planopt.planning.values.context import StepContext, structure_of
from planopt.planning.values.local_value import local_value, stage_predictor
from planopt.planning.values.reach_cost import ReachCost
from planopt.planning.values.rule_rows import (
    RuleRows,
    has_step_rows,
    has_sum_row,
    rows_again,
    rule_rows,
)
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive, braked_motion
from planopt.targets.rounding import Derivatives
from planopt.world.moving_discs import MovingDiscs
from planopt.world.separation import (
    PackedPieces,
    SeparatingLines,
    joined_lines,
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
            shape = PathShape(
                settings.horizon,
                lines,
                structure_of(self._problem),
                has_step_rows(self._problem),
                has_sum_row(self._problem),
                motion_shape(self._problem, lines),
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
        tried: list[tuple[float, RuleResult]] = []
        for attempt in range(REPAIRS + allocations):
            begun = perf_counter()
            point = polish_path(nlp, task)
            drive = refined_drive(problem, scorer.state, point.inputs)
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
            if improvable and scorer.worth(candidate) < guess.value:
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
            again = rows_again(context, rows, candidate.path_m, tried, result)
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


class GoalRefinement:
    """Refinement of one step's guesses to a goal, in the order of the fallbacks."""

    def __init__(
        self,
        nlp: PathNlp,
        scene: Scene,
        scorer: Scorer,
        cost: ReachCost,
        start: GlobalStart,
        ahead: Ahead,
        lattice_objective: float,
        budget: Budget,
        rows_of: Callable[[NDArray[np.float64]], RuleRows] | None = None,
    ) -> None:
        self._nlp = nlp
        self._scene = scene
        self._scorer = scorer
        self._cost = cost
        self._start = start
        self._ahead = ahead
        self._lattice_objective = lattice_objective
        self._budget = budget
        self._rows_of = rows_of
        self._rows = None if rows_of is None else rows_of(start.path_m)

    def attempts(self, shifted_m: NDArray[np.float64] | None) -> Iterator[Candidate]:
        """Yield verified candidates, best guess first, each with the effort since the last one.

        The shifted last plan is the better guess if it arrives sooner than the lattice path.
        """
        starts: list[tuple[NDArray[np.float64], Rung]] = (
            [(self._start.path_m, Rung.RELAXED)]
            if bool((self._start.margin_db < 0.0).any())
            else [(self._retimed(), Rung.PLAN), (self._start.path_m, Rung.COLD_RETRY)]
        )
        shifted_m = None if shifted_m is None else self._drawn_on(shifted_m)
        if shifted_m is not None:
            relaxes = bool((self._start_margins(shifted_m) < 0.0).any())
            if self._scorer.objective(shifted_m) < self._lattice_objective:
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

    def _drawn_on(self, shifted_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the shifted last plan, with its last step towards the pivot."""
        problem, before = self._scorer.problem, shifted_m[-1]
        to_pivot = self._ahead.leading(before).position_m - before
        away, longest = float(np.linalg.norm(to_pivot)), problem.step_length_m - STEP_PAD_M
        goal_away = np.linalg.norm(before - np.asarray(problem.goal_m))
        if len(shifted_m) == 1 or away == 0.0 or goal_away <= problem.constraints.goal_radius_m:
            return shifted_m
        return np.vstack([shifted_m[:-1], before + to_pivot * min(1.0, longest / away)])

    def _retimed(self) -> NDArray[np.float64]:
        """Return the lattice path at cruising speed."""
        problem = self._scorer.problem
        speed = cruising_speed_m_s(
            problem.reach.effort_weight_s2_m2, problem.robots[0].speed_max_m_s
        )
        step = speed * problem.planner.step_s - STEP_PAD_M
        return retime(self._scorer.position_m, self._start.path_m, self._start.beyond_m, step)

    def _sooner(self, candidate: Candidate) -> Candidate | None:
        """Return a candidate that arrives in fewer steps; None if the path is too long."""
        problem = self._scorer.problem
        path = np.vstack([self._scorer.position_m, candidate.path_m])
        away = np.linalg.norm(path - np.asarray(problem.goal_m), axis=1)
        there = np.nonzero(away <= problem.constraints.goal_radius_m)[0]
        if candidate.verdict is not Verdict.VERIFIED or there.size == 0 or there[0] < 2:
            return None
        if self._budget.spent:
            return None
        faster = retime(path[0], candidate.path_m, path[:0], problem.step_length_m - STEP_PAD_M)
        if np.linalg.norm(faster[there[0] - 2] - faster[-1]) > 0.0:
            return None
        begun = perf_counter()
        self._look_at(faster)
        task = self._task(faster)
        bound = self._asked(np.minimum(_margins_at(task, faster), MARGIN_PAD_DB))
        refined = polish_path(self._nlp, replace(task, bound_db=bound))
        iterations = candidate.iterations + refined.iterations
        solve_s = candidate.solve_s + perf_counter() - begun
        better = self._assessed(refined, candidate.rung, solve_s, iterations)
        is_better = better.objective < candidate.objective
        return better if better.verdict is Verdict.VERIFIED and is_better else None

    def _from(self, path_m: NDArray[np.float64], rung: Rung) -> Iterator[Candidate]:
        """Yield refinements of a path, each with lines for the verified violations added.

        Steps that meet the bound in the guess must keep it; with `rung` RELAXED others are free.
        """
        if self._budget.spent:
            return
        self._look_at(path_m)
        task = self._task(path_m)
        exact = self._start_margins(path_m)
        local = _margins_at(task, path_m)
        # If the local model is optimistic, its bound is raised by the error.
        wanted = MARGIN_PAD_DB + np.maximum(local - exact, 0.0)
        begun = perf_counter()
        iterations = 0
        free = (exact < 0.0) & (rung is Rung.RELAXED)
        # A guess that meets the bound must stay feasible.
        bound = np.where(exact >= 0.0, np.minimum(wanted, local), wanted)
        bound[free] = -np.inf
        for _ in range(REPAIRS):
            if self._budget.spent:
                return
            refined = polish_path(self._nlp, replace(task, bound_db=self._asked(bound)))
            iterations += refined.iterations
            candidate = self._assessed(refined, rung, perf_counter() - begun, iterations)
            yield candidate
            begun, iterations = perf_counter(), 0
            if not candidate.sound:
                lines = lines_with_violated(
                    self._scorer.problem,
                    self._scene.pieces,
                    self._scorer.context.moving,
                    task.lines,
                    np.vstack([task.start_m, path_m]),
                    np.vstack([task.start_m, refined.path_m]),
                )
                if lines is None:
                    return
                task = replace(task, lines=lines)
            if candidate.power is None:
                return
            planned = Prediction(candidate.power.mean_db[1:], candidate.power.deviation_db[1:])
            lacking = np.where(free, 0.0, -self._margins_db(planned))
            if candidate.sound and not (lacking > 0.0).any():
                return
            bound = bound + np.where(lacking > 0.0, lacking + MARGIN_PAD_DB, 0.0)

    def _task(self, path_m: NDArray[np.float64]) -> PathTask:
        """Return the data of the refinement of a guess."""
        scorer = self._scorer
        problem, pivot = scorer.problem, self._ahead.leading(path_m[-1])
        ends = np.vstack([scorer.position_m, path_m])
        lines = lines_about(
            problem, self._scene.pieces, scorer.context.moving, ends, self._nlp.shape.lines
        )
        goal = np.asarray(problem.goal_m)
        at_goal = np.linalg.norm(path_m[-1] - goal) <= problem.constraints.goal_radius_m
        # A guess that waits at its end has arrived, at the goal or a waiting position; spread over
        # the whole horizon, its refinement would never arrive.
        standing = np.linalg.norm(path_m - path_m[-1], axis=1) <= STANDSTILL_M
        arrival = len(path_m) - int(np.argmin(standing[::-1])) if not standing.all() else 0
        dwells = at_goal or arrival < len(path_m) - 1
        value = GoalValue(
            start_m=scorer.position_m,
            pivot_m=pivot.position_m,
            effort_s_m2=problem.reach.effort_weight_s2_m2 / problem.planner.step_s,
            rate_s_m=self._cost.rate_s_m * max(pivot.metre_cost, self._dearest_metre(path_m)),
            outage=self._outage(path_m),
            margins=self._margins_about(path_m),
        )
        return PathTask(
            start_m=scorer.position_m,
            path_m=path_m,
            lines=lines,
            clearance_m=problem.constraints.clearance_m,
            step_length_m=problem.step_length_m,
            bounds_m=problem.workspace.bounds_m,
            evaluate=value,
            scale=1.0,
            bound_db=np.full(len(path_m), -np.inf),
            arrival=arrival + 1 if dwells else None,
        )

    def _dearest_metre(self, path_m: NDArray[np.float64]) -> float:
        """Return the largest cost per metre along a path; a lower rate would not pay for it."""
        return float(self._cost.metre_costs(path_m).max())

    def _outage(self, path_m: NDArray[np.float64]) -> OutagePrice:
        """Return the price of outage along a path."""
        before, charged = self._cost.outage_charges(path_m)
        price = self._cost.rate_s_m * self._cost.outage_price
        return OutagePrice(price, before, charged)

    def _margins_about(
        self, path_m: NDArray[np.float64]
    ) -> Callable[[NDArray[np.float64]], tuple[Derivatives, Derivatives]]:
        """Return margins and scores from the measurements nearest to each stage of a path."""
        problem = self._scorer.problem
        predict_stages = stage_predictor(
            self._scorer.context.law,
            path_m,
            problem.planner.neighbours,
        )
        threshold = problem.stations[0].threshold_dbm
        z: float | NDArray[np.float64] = bound_quantile(problem.constraints.p_min)
        if self._rows is not None:
            threshold, z = self._rows.threshold_dbm, self._rows.quantile

        def margins(positions_m: NDArray[np.float64]) -> tuple[Derivatives, Derivatives]:
            power = predict_stages(positions_m)
            scores = scores_of(*power, self._cost.threshold_dbm)
            return margins_of(*power, threshold, z), scores

        return margins

    def _start_margins(self, path_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the margins of a guess."""
        if self._rows_of is not None:
            rows = self._rows_of(path_m)
            return rows.margins_db(self._cost.power(path_m))
        return self._margins_db(self._cost.power(path_m))

    def _look_at(self, path_m: NDArray[np.float64]) -> None:
        """Update the rule's rows for a path."""
        if self._rows_of is not None:
            self._rows = self._rows_of(path_m)

    def _margins_db(self, power: Prediction) -> NDArray[np.float64]:
        """Return the margins of the rows; infinite at unconstrained steps."""
        return (
            self._scorer.margins_db(power) if self._rows is None else self._rows.margins_db(power)
        )

    def _asked(self, bound_db: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the bounds of the constrained steps, minus infinity at others."""
        return bound_db if self._rows is None else np.where(self._rows.asked, bound_db, -np.inf)

    def _assessed(
        self, refined: RefinedPath, rung: Rung, solve_s: float, iterations: int
    ) -> Candidate:
        candidate = candidate_of(self._scorer, refined, rung, self._lattice_objective, solve_s)
        assessed = self._scorer.assessed(replace(candidate, iterations=iterations))
        # The refined path may meet a bound that the guess misses.
        met_after_all = rung is Rung.RELAXED and not assessed.relaxes
        return replace(assessed, rung=Rung.PLAN) if met_after_all else assessed


def _margins_at(task: PathTask, path_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the margins (N,) of a path by the local model."""
    margins = task.evaluate(path_m).margins
    if margins is None:
        raise AssertionError("a path to a goal has margins")
    return margins.value
