"""Solver attempts from a global start: polish, tighten where the proof objects, retry, relax."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import bound_margin_db, bound_quantile
from planopt.channel.neighbours import neighbour_model
from planopt.planning.candidate import Candidate, Judge
from planopt.planning.global_search import GlobalStart
from planopt.planning.margin_source import MarginFunction
from planopt.planning.plan import Rung, Termination
from planopt.planning.polish import Polished, ReachTask, polish
from planopt.planning.reach_nlp import ReachNlp
from planopt.planning.stage_kernel import StageMargins, stage_margins
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M, MARGIN_PAD_DB
from planopt.planning.verify import certified_prediction
from planopt.world.separation import SeparatingLines, lines_for, separating_lines

LINE_REACH_STEPS = 2.0
"""Pieces farther than this many longest steps from a segment get no line."""
REPAIRS = 3
"""How often a polish whose proof objects is repeated with the objection built in."""
SLACK_TOLERANCE_DB = 1e-3
"""Missing dB below this count as none: the bound can be met after all."""


class Refiner:
    """Attempts of one step, in the order of the ladder.

    Parameters
    ----------
    nlp
        The built solver.
    judge
        What attempts are judged by; its pivot is set.
    start
        The global start.
    lattice_objective
        Its cost.
    """

    def __init__(
        self, nlp: ReachNlp, judge: Judge, start: GlobalStart, lattice_objective: float
    ) -> None:
        self._nlp = nlp
        self._judge = judge
        self._start = start
        self._lattice_objective = lattice_objective

    def attempts(self, shifted_m: NDArray[np.float64] | None) -> Iterator[Candidate]:
        """Yield judged candidates, best hope first; the caller stops when one is good enough."""
        relaxing = bool((self._start.margin_db < 0.0).any())
        yield from self._from(self._start.path_m, Rung.RELAXED if relaxing else Rung.PLAN)
        if shifted_m is not None and len(shifted_m) == self._nlp.horizon:
            yield from self._from(shifted_m, Rung.COLD_RETRY)

    def _from(self, path_m: NDArray[np.float64], rung: Rung) -> Iterator[Candidate]:
        """Polish from a path, repeating with what the verifier objects to built in."""
        task = self._task(path_m)
        exact = self._exact_margins(path_m)
        local = task.margins(path_m).value
        # Where the local model is too optimistic by e, ask it for e more.
        wanted = MARGIN_PAD_DB + np.maximum(local - exact, 0.0)
        begun = perf_counter()
        iterations = 0
        if (exact < 0.0).any():
            elastic = polish(
                self._nlp,
                replace(
                    task,
                    bound_db=wanted,
                    slack_limit_db=np.where(exact < 0.0, np.inf, 0.0),
                    elastic=True,
                ),
            )
            iterations += elastic.iterations
            missing = np.where(elastic.slack_db > SLACK_TOLERANCE_DB, elastic.slack_db, 0.0)
            usable = elastic.termination is Termination.CONVERGED
            if usable:
                bound = wanted - missing
                task = replace(task, path_m=elastic.path_m)
            else:
                bound = np.minimum(wanted, local)
                missing = np.maximum(-exact, 0.0)
        else:
            bound = np.minimum(wanted, local)
            missing = np.zeros_like(bound)
        for _ in range(REPAIRS):
            polished = polish(self._nlp, replace(task, bound_db=bound))
            iterations += polished.iterations
            candidate = self._judged(polished, rung, perf_counter() - begun, iterations)
            yield candidate
            if not candidate.sound:
                lines = self._with_offenders(task.lines, path_m, polished.path_m)
                if lines is None:
                    return
                task = replace(task, lines=lines)
            lacking = -missing - self._exact_margins(polished.path_m)
            if candidate.sound and not (lacking > 0.0).any():
                return
            bound = bound + np.where(lacking > 0.0, lacking + MARGIN_PAD_DB, 0.0)

    def _task(self, path_m: NDArray[np.float64]) -> ReachTask:
        """Set the programme up about a start path."""
        judge = self._judge
        problem, pivot = judge.problem, judge.pivot
        if pivot is None:
            raise AssertionError("a refiner needs a pivot")
        ends = np.vstack([judge.position_m, path_m])
        lines = separating_lines(
            judge.scene.pieces,
            ends[:-1],
            ends[1:],
            self._nlp.lines,
            LINE_REACH_STEPS * problem.step_length_m,
        )
        goal = np.asarray(problem.robots[0].goal_m)
        away = np.linalg.norm(path_m - goal, axis=1)
        at_goal = np.nonzero(away <= problem.constraints.goal_radius_m)[0]
        return ReachTask(
            start_m=judge.position_m,
            path_m=path_m,
            lines=lines,
            clearance_m=problem.constraints.clearance_m,
            step_length_m=problem.step_length_m,
            bounds_m=problem.workspace.bounds_m,
            arrival=int(at_goal[0]) + 1 if at_goal.size else None,
            pivot_m=pivot.position_m,
            effort_s_m2=problem.objective.effort_weight_s2_m2 / problem.planner.step_s,
            rate_s_m=judge.rate_s_m,
            margins=self._margins_about(path_m),
            bound_db=np.full(len(path_m), -np.inf),
            slack_limit_db=np.zeros(len(path_m)),
        )

    def _margins_about(self, path_m: NDArray[np.float64]) -> MarginFunction:
        """Margins conditioned on the measurements nearest to each stage of a path."""
        problem = self._judge.problem
        model = neighbour_model(self._judge.belief.posterior, path_m, problem.planner.neighbours)
        threshold = problem.stations[0].threshold_dbm
        z = bound_quantile(problem.constraints.p_min)

        def margins(positions_m: NDArray[np.float64]) -> StageMargins:
            return stage_margins(model, positions_m, threshold, z)

        return margins

    def _exact_margins(self, path_m: NDArray[np.float64]) -> NDArray[np.float64]:
        judge = self._judge
        power = certified_prediction(judge.belief.posterior, path_m)[0]
        return bound_margin_db(
            power.mean_db,
            power.deviation_db,
            judge.problem.stations[0].threshold_dbm,
            judge.problem.constraints.p_min,
        )

    def _judged(self, polished: Polished, rung: Rung, solve_s: float, iterations: int) -> Candidate:
        candidate = self._judge.candidate(polished.path_m, rung, polished.termination)
        return self._judge.judged(
            replace(
                candidate,
                lattice_objective=self._lattice_objective,
                solve_s=solve_s,
                iterations=iterations,
                kkt_residual=polished.kkt_residual,
                multipliers=polished.multipliers,
            )
        )

    def _with_offenders(
        self,
        lines: SeparatingLines,
        start_path_m: NDArray[np.float64],
        path_m: NDArray[np.float64],
    ) -> SeparatingLines | None:
        """Lines of the start path with the pieces that the result comes too near to put in.

        None if no piece is to blame.
        """
        judge = self._judge
        ends = np.vstack([judge.position_m, path_m])
        now = separating_lines(
            judge.scene.pieces,
            ends[:-1],
            ends[1:],
            self._nlp.lines,
            judge.problem.step_length_m,
        )
        pieces = lines.piece.copy()
        changed = False
        limit = judge.problem.constraints.clearance_m - CLEARANCE_TOLERANCE_M
        for k, j in zip(*np.nonzero(now.gaps < limit), strict=True):
            offender = now.piece[k, j]
            if offender >= 0 and offender not in pieces[k]:
                pieces[k, -1] = offender
                changed = True
        if not changed:
            return None
        first = np.vstack([judge.position_m, start_path_m])
        return lines_for(judge.scene.pieces, first[:-1], first[1:], pieces)
