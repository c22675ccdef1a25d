"""Refinement of initial guesses for one step of a goal problem."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from planopt.arrays import Floats
from planopt.channel.prediction import Prediction
from planopt.objectives.reach import cruising_speed_m_s
from planopt.objectives.stage_power import scores_of, stage_predictor
from planopt.planning.candidates import Budget, Candidate, Scorer
from planopt.planning.plan import Rung, Verdict
from planopt.planning.programme.goal_value import GoalValue, OutagePrice, margins_of
from planopt.planning.programme.path_nlp import PathNlp
from planopt.planning.programme.path_polish import (
    REPAIRS,
    PathTask,
    lines_about,
    lines_with_violated,
    polish_path,
)
from planopt.planning.refinement import candidate_of, tightened
from planopt.planning.scene import Scene, retime
from planopt.planning.search.global_search import GlobalStart
from planopt.planning.search.pivot import Ahead
from planopt.planning.tolerances import MARGIN_PAD_DB, STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.planning.values.objective_value import ReachCost
from planopt.planning.values.rule_rows import RuleRows, step_rows
from planopt.targets.rounding import Derivatives


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
        """Yield verified or rejected candidates, those from the best guess first.

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
        if candidate.verdict is not Verdict.VERIFIED or there.size == 0 or there[0] < 2:
            return None
        if self.budget.spent:
            return None
        faster = retime(path[0], candidate.path_m, path[:0], problem.step_length_m - STEP_PAD_M)
        if np.linalg.norm(faster[there[0] - 2] - faster[-1]) > 0.0:
            return None
        begun = perf_counter()
        rows = step_rows(self.step, faster)
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
                lines = lines_with_violated(
                    self.scorer.problem,
                    self.scene.pieces,
                    self.scorer.context.moving,
                    task.lines,
                    np.vstack([task.start_m, path_m]),
                    np.vstack([task.start_m, candidate.path_m]),
                )
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
        solve_s = perf_counter() - begun_s
        candidate = candidate_of(self.scorer, point, rung, self.lattice_objective, solve_s)
        assessed = self.scorer.assessed(candidate)
        # The refined path may satisfy a constraint that the guess violates.
        met_after_all = rung is Rung.RELAXED and not assessed.relaxes
        return replace(assessed, rung=Rung.PLAN) if met_after_all else assessed

    def _task(self, path_m: Floats, rows: RuleRows) -> PathTask:
        """Return the optimisation problem that refines a guess `path_m`."""
        scorer, cost = self.scorer, self.cost
        problem, pivot = scorer.problem, self.ahead.leading(path_m[-1])
        ends = np.vstack([scorer.position_m, path_m])
        at_goal = (
            np.linalg.norm(path_m[-1] - np.asarray(problem.goal_m))
            <= problem.constraints.goal_radius_m
        )
        # A guess that waits at its end has arrived, at the goal or a waiting position. A refinement
        # over the whole horizon would never arrive.
        standing = np.linalg.norm(path_m - path_m[-1], axis=1) <= STANDSTILL_M
        arrival = len(path_m) - int(np.argmin(standing[::-1])) if not standing.all() else 0
        dwells = at_goal or arrival < len(path_m) - 1
        before, charged = cost.outage_charges(path_m)
        # The rate must cover the most expensive metre of the path, or driving it would not pay.
        metre_cost = max(pivot.metre_cost, float(cost.metre_costs(path_m).max()))
        value = GoalValue(
            start_m=scorer.position_m,
            pivot_m=pivot.position_m,
            effort_s_m2=problem.reach.effort_weight_s2_m2 / problem.planner.step_s,
            rate_s_m=cost.rate_s_m * metre_cost,
            outage=OutagePrice(cost.rate_s_m * cost.outage_price, before, charged),
            margins=self._margins_about(path_m, rows),
        )
        return PathTask(
            start_m=scorer.position_m,
            path_m=path_m,
            lines=lines_about(
                problem, self.scene.pieces, scorer.context.moving, ends, self.nlp.shape.lines
            ),
            clearance_m=problem.constraints.clearance_m,
            step_length_m=problem.step_length_m,
            bounds_m=problem.workspace.bounds_m,
            evaluate=value,
            scale=1.0,
            arrival=arrival + 1 if dwells else None,
        )

    def _margins_about(
        self, path_m: Floats, rows: RuleRows
    ) -> Callable[[Floats], tuple[Derivatives, Derivatives]]:
        """Return a function that maps a path to margins and scores, from nearby measurements."""
        law, neighbours = self.scorer.context.law, self.scorer.problem.planner.neighbours
        predict_stages, quantile = stage_predictor(law, path_m, neighbours), rows.quantile

        def margins(positions_m: Floats) -> tuple[Derivatives, Derivatives]:
            power = predict_stages(positions_m)
            scores = scores_of(*power, self.cost.threshold_dbm)
            return margins_of(*power, rows.threshold_dbm, quantile), scores

        return margins
