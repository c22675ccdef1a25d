"""Refinements of the guesses of one step to a goal, tightened where the verifier objects."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, bound_quantile
from planopt.objectives.reach import cruising_speed_m_s
from planopt.objectives.stage_power import scores_of
from planopt.planning.candidates import Budget, Candidate, Judge
from planopt.planning.plan import Rung, Verdict
from planopt.planning.programme.clearance_lines import REPAIRS, lines_about, lines_with_violated
from planopt.planning.programme.evaluation import margins_of
from planopt.planning.programme.goal_value import GoalValue, OutagePrice
from planopt.planning.programme.path_nlp import PathNlp
from planopt.planning.programme.path_polish import PathTask, RefinedPath, polish_path
from planopt.planning.scene import Scene
from planopt.planning.search.global_search import GlobalStart
from planopt.planning.search.pivot import Ahead
from planopt.planning.search.taut_way import retime
from planopt.planning.tolerances import (
    MARGIN_PAD_DB,
    STANDSTILL_M,
    STEP_PAD_M,
)
from planopt.planning.values.local_value import stage_predictor
from planopt.planning.values.reach_cost import ReachCost
from planopt.planning.values.rule_rows import RuleRows
from planopt.targets.rounding import Derivatives


class Refiner:
    """Attempts of one step, in the order of the fallbacks."""

    def __init__(
        self,
        nlp: PathNlp,
        scene: Scene,
        judge: Judge,
        cost: ReachCost,
        start: GlobalStart,
        ahead: Ahead,
        lattice_objective: float,
        budget: Budget,
        rows_of: Callable[[NDArray[np.float64]], RuleRows] | None = None,
    ) -> None:
        self._nlp = nlp
        self._scene = scene
        self._judge = judge
        self._cost = cost
        self._start = start
        self._ahead = ahead
        self._lattice_objective = lattice_objective
        self._budget = budget
        self._rows_of = rows_of
        self._rows = None if rows_of is None else rows_of(start.path_m)

    def attempts(self, shifted_m: NDArray[np.float64] | None) -> Iterator[Candidate]:
        """Yield judged candidates, best hope first; the caller stops when one is good enough.

        Each has the time and iterations that were spent since the one before it.

        The last plan, shifted, is the better start where it arrives sooner than the lattice, which
        only ends on nodes.
        """
        starts: list[tuple[NDArray[np.float64], Rung]] = (
            [(self._start.path_m, Rung.RELAXED)]
            if bool((self._start.margin_db < 0.0).any())
            else [(self._retimed(), Rung.PLAN), (self._start.path_m, Rung.COLD_RETRY)]
        )
        shifted_m = None if shifted_m is None else self._drawn_on(shifted_m)
        if shifted_m is not None:
            relaxes = bool((self._start_margins(shifted_m) < 0.0).any())
            if self._judge.objective(shifted_m) < self._lattice_objective:
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
        """The last plan, shifted, with its last step leading on."""
        problem, before = self._judge.problem, shifted_m[-1]
        to_pivot = self._ahead.leading(before).position_m - before
        away, longest = float(np.linalg.norm(to_pivot)), problem.step_length_m - STEP_PAD_M
        goal_away = np.linalg.norm(before - np.asarray(problem.goal_m))
        if len(shifted_m) == 1 or away == 0.0 or goal_away <= problem.constraints.goal_radius_m:
            return shifted_m
        return np.vstack([shifted_m[:-1], before + to_pivot * min(1.0, longest / away)])

    def _retimed(self) -> NDArray[np.float64]:
        """Start path at cruising speed."""
        problem = self._judge.problem
        speed = cruising_speed_m_s(
            problem.reach.effort_weight_s2_m2, problem.robots[0].speed_max_m_s
        )
        step = speed * problem.planner.step_s - STEP_PAD_M
        return retime(self._judge.position_m, self._start.path_m, self._start.beyond_m, step)

    def _sooner(self, candidate: Candidate) -> Candidate | None:
        """Arrive in fewer steps if the refined path is short enough for it; None if it is not."""
        problem = self._judge.problem
        path = np.vstack([self._judge.position_m, candidate.path_m])
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
        better = self._judged(refined, candidate.rung, solve_s, iterations)
        is_better = better.objective < candidate.objective
        return better if better.verdict is Verdict.VERIFIED and is_better else None

    def _from(self, path_m: NDArray[np.float64], rung: Rung) -> Iterator[Candidate]:
        """Refine from a path, repeating with what the verifier objects to built in.

        A step that keeps the bound at the start keeps it. With `rung` RELAXED a step below it stays
        free.
        """
        if self._budget.spent:
            return
        self._look_at(path_m)
        task = self._task(path_m)
        exact = self._start_margins(path_m)
        local = _margins_at(task, path_m)
        # Where the local model is too optimistic by e, ask it for e more.
        wanted = MARGIN_PAD_DB + np.maximum(local - exact, 0.0)
        begun = perf_counter()
        iterations = 0
        free = (exact < 0.0) & (rung is Rung.RELAXED)
        # The start stays feasible where it keeps the bound, be it with less than is wanted.
        bound = np.where(exact >= 0.0, np.minimum(wanted, local), wanted)
        bound[free] = -np.inf
        for _ in range(REPAIRS):
            if self._budget.spent:
                return
            refined = polish_path(self._nlp, replace(task, bound_db=self._asked(bound)))
            iterations += refined.iterations
            candidate = self._judged(refined, rung, perf_counter() - begun, iterations)
            yield candidate
            begun, iterations = perf_counter(), 0
            if not candidate.sound:
                lines = lines_with_violated(
                    self._scene.pieces,
                    task.lines,
                    np.vstack([task.start_m, path_m]),
                    np.vstack([task.start_m, refined.path_m]),
                    task.clearance_m,
                    task.step_length_m,
                    self._judge.context.moving,
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
        """Set the programme up about a start path."""
        judge = self._judge
        problem, pivot = judge.problem, self._ahead.leading(path_m[-1])
        ends = np.vstack([judge.position_m, path_m])
        lines = lines_about(
            self._scene.pieces,
            judge.context.moving,
            ends,
            self._nlp.shape.lines,
            problem.constraints.clearance_m,
            problem.step_length_m,
        )
        goal = np.asarray(problem.goal_m)
        at_goal = np.linalg.norm(path_m[-1] - goal) <= problem.constraints.goal_radius_m
        # Where the start path stands still at its end it has arrived, at the goal or where it
        # waits or measures. Spread over the whole horizon, such a way would never end.
        standing = np.linalg.norm(path_m - path_m[-1], axis=1) <= STANDSTILL_M
        arrival = len(path_m) - int(np.argmin(standing[::-1])) if not standing.all() else 0
        dwells = at_goal or arrival < len(path_m) - 1
        value = GoalValue(
            start_m=judge.position_m,
            pivot_m=pivot.position_m,
            effort_s_m2=problem.reach.effort_weight_s2_m2 / problem.planner.step_s,
            rate_s_m=self._cost.rate_s_m * max(pivot.metre_cost, self._dearest_metre(path_m)),
            outage=self._outage(path_m),
            margins=self._margins_about(path_m),
        )
        return PathTask(
            start_m=judge.position_m,
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
        """Cost of the dearest metre along a path.

        To come nearer must never cost more than it is worth, or the path ends where it begins.
        """
        return float(self._cost.metre_costs(path_m).max())

    def _outage(self, path_m: NDArray[np.float64]) -> OutagePrice:
        """Return the cost of being out of contact along a path."""
        before, charged = self._cost.outage_charges(path_m)
        price = self._cost.rate_s_m * self._cost.outage_price
        return OutagePrice(price, before, charged)

    def _margins_about(
        self, path_m: NDArray[np.float64]
    ) -> Callable[[NDArray[np.float64]], tuple[Derivatives, Derivatives]]:
        """Margins and scores conditioned on the measurements nearest to each stage of a path."""
        problem = self._judge.problem
        predict_stages = stage_predictor(
            self._judge.context.law,
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
        """Margins of a start path."""
        if self._rows_of is not None:
            rows = self._rows_of(path_m)
            return rows.margins_db(self._cost.power(path_m))
        return self._margins_db(self._cost.power(path_m))

    def _look_at(self, path_m: NDArray[np.float64]) -> None:
        """Take the rule's rows about a path."""
        if self._rows_of is not None:
            self._rows = self._rows_of(path_m)

    def _margins_db(self, power: Prediction) -> NDArray[np.float64]:
        """Margins that the rows ask for; infinite where nothing is asked."""
        return self._judge.margins_db(power) if self._rows is None else self._rows.margins_db(power)

    def _asked(self, bound_db: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bounds at the steps that are asked for, none at others."""
        return bound_db if self._rows is None else np.where(self._rows.asked, bound_db, -np.inf)

    def _judged(
        self, refined: RefinedPath, rung: Rung, solve_s: float, iterations: int
    ) -> Candidate:
        candidate = self._judge.candidate(refined.path_m, rung, refined.termination)
        judged = self._judge.judged(
            replace(
                candidate,
                lattice_objective=self._lattice_objective,
                solve_s=solve_s,
                iterations=iterations,
                kkt_residual=refined.kkt_residual,
                multipliers=refined.multipliers,
            )
        )
        # Moved a little, the path may keep the bound after all.
        met_after_all = rung is Rung.RELAXED and not judged.relaxes
        return replace(judged, rung=Rung.PLAN) if met_after_all else judged


def _margins_at(task: PathTask, path_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the margins (N,) of a path by the local model."""
    margins = task.evaluate(path_m).margins
    if margins is None:
        raise AssertionError("the way to a goal has margins")
    return margins.value
