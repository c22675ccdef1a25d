"""One receding-horizon step for a sum of terms: global starts, polish, guard, proof, ladder."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import bound_margin_db
from planopt.channel.prediction import Prediction
from planopt.planning.candidate import Candidate, Judge
from planopt.planning.driven import (
    driven_starts,
    motion_shape,
    motion_task,
    polished_drive,
    without_start,
)
from planopt.planning.ground import Ground
from planopt.planning.plan import Plan, Rung, Termination, Verdict
from planopt.planning.programme.offenders import LINE_REACH_STEPS, REPAIRS, lines_with_offenders
from planopt.planning.programme.path_nlp import PathNlp, build_path_nlp
from planopt.planning.programme.path_polish import PathTask, polish_path
from planopt.planning.programme.polished import Polished
from planopt.planning.search.start_search import Start, StartSearch
from planopt.planning.shifted import shifted_path
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB
from planopt.planning.worth.local_worth import is_stagewise, local_worth
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem
from planopt.world.separation import separating_lines

LINES_PER_SEGMENT = 2
"""Nearest convex pieces that each segment is kept from; the verifier looks at all (fast.md)."""

LOCAL_PAD_DB = 0.04
"""Margin asked of the local model, corrected at the start, beyond the bound: it is off by less at
nine of ten returned points (48 neighbours, 1,000 measurements, xi 4, beta 20 m)."""

VALUE_IN_SOLVER = 10.0
"""What the start's worth counts in the solver, whatever its unit: its tolerances are absolute."""

GIVEN_UP_DB = 1e-3
"""A larger slack says that the solver found no better place; a smaller one is its tolerance."""

MISSING_DB_COST = 100.0
"""What a missing dB counts in the solver, where the bound cannot be kept."""


class HorizonPlanner:
    """Plans for one robot of a problem whose objective is a sum of terms.

    Parameters
    ----------
    problem
        With one robot; its planner settings say how.
    ground
        Its geometry.
    thorough
        Follow starts of several parts of the reachable places, each polished twice, and take the
        best, instead of the first that is verified.
    """

    def __init__(self, problem: Problem, ground: Ground, thorough: bool = False) -> None:
        self._thorough = thorough
        self.problem = problem
        self.ground = ground
        self._search = StartSearch(problem, ground, thorough)
        self._bounded = problem.constraints.p_min > 0.0
        self._driven = problem.robots[0].dynamics is not None
        self._nlp: PathNlp | None = None
        if problem.planner.name == "auto":
            self._nlp = build_path_nlp(
                problem.planner.horizon,
                LINES_PER_SEGMENT,
                is_stagewise(problem),
                self._bounded,
                motion_shape(problem, LINES_PER_SEGMENT),
            )

    def plan(self, situation: Situation, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is.

        Parameters
        ----------
        situation
            What is known.
        judge
            What candidates are judged by; its objective is the situation's worth.
        warm
            The plan that led here, one step old; only used if it was verified.
        """
        begun = perf_counter()
        starts = self._search.find_starts(situation, shifted_path(warm))
        if self._driven:
            starts = driven_starts(judge, situation, starts, warm)
        chosen = self._climb(situation, judge, starts, warm)
        return judge.plan_from(chosen, wall_s=perf_counter() - begun)

    def _climb(
        self, situation: Situation, judge: Judge, starts: list[Start], warm: Plan | None
    ) -> Candidate:
        """Go down the failure ladder until a candidate is verified; else the least bad one."""
        tried: list[Candidate] = []
        verified: list[Candidate] = []
        for number, start in enumerate(starts):
            unpolished = replace(
                judge.candidate(start.path_m, Rung.LATTICE, Termination.LATTICE_ONLY, start.drive),
                lattice_objective=starts[0].worth,
            )
            if self._nlp is None:
                unpolished = replace(unpolished, rung=Rung.PLAN)
            else:
                rung = Rung.PLAN if number == 0 or self._driven else Rung.COLD_RETRY
                for candidate in self.polished(situation, judge, start, rung):
                    if candidate.verdict is Verdict.VERIFIED:
                        verified.append(candidate)
                    tried.append(candidate)
            if not any(c.objective >= unpolished.objective for c in verified):
                unpolished = judge.judged(unpolished)
                tried.append(unpolished)
                if unpolished.verdict is Verdict.VERIFIED:
                    verified.append(unpolished)
            if verified and not (self._thorough or self._driven):
                break
        if verified:
            return _with_effort(max(verified, key=lambda c: c.objective), tried)
        fallback = self._without_start(judge, warm)
        if fallback.verdict is Verdict.VERIFIED:
            return _with_effort(fallback, tried)
        # Nothing is verified. Connectivity may be given up, clearance and speed never.
        sound = [candidate for candidate in tried if candidate.sound]
        if self._driven:
            sound.sort(key=lambda candidate: candidate.missing_db)
        return _with_effort(sound[0] if sound else fallback, tried)

    def _without_start(self, judge: Judge, warm: Plan | None) -> Candidate:
        """Take the last verified plan, shifted and checked again; else stop."""
        if self._driven:
            return without_start(judge, warm)
        horizon = self.problem.planner.horizon
        path = shifted_path(warm)
        if path is not None and len(path) == horizon:
            shifted = judge.judged(judge.candidate(path, Rung.SHIFTED, Termination.STOPPED))
            if shifted.verdict is Verdict.VERIFIED:
                return shifted
        standing = np.tile(judge.position_m, (horizon, 1))
        return judge.judged(judge.candidate(standing, Rung.STOP, Termination.NO_PATH))

    def polished(
        self, situation: Situation, judge: Judge, start: Start, rung: Rung
    ) -> list[Candidate]:
        """Candidates that a start leads to, judged.

        If thorough, the best of them is polished again, from the measurements and the sides of
        obstacles that are nearest to it.
        """
        found = self._attempts(situation, judge, start, rung)
        verified = [candidate for candidate in found if candidate.verdict is Verdict.VERIFIED]
        if not (self._thorough and verified):
            return found
        best = max(verified, key=lambda candidate: candidate.objective)
        again = replace(start, path_m=best.path_m)
        return found + self._attempts(situation, judge, again, rung)

    def _attempts(
        self, situation: Situation, judge: Judge, start: Start, rung: Rung
    ) -> list[Candidate]:
        """Polish a start, repeating with what the proof objects to built in."""
        problem, nlp = self.problem, self._nlp
        if nlp is None:
            raise AssertionError("this planner does not polish")
        evaluate = local_worth(situation, start.path_m)
        ends = np.vstack([situation.position_m, start.path_m])
        task = PathTask(
            start_m=situation.position_m,
            path_m=start.path_m,
            lines=separating_lines(
                self.ground.pieces,
                ends[:-1],
                ends[1:],
                nlp.lines,
                LINE_REACH_STEPS * problem.step_length_m,
            ),
            clearance_m=problem.constraints.clearance_m,
            step_length_m=problem.step_length_m,
            bounds_m=problem.workspace.bounds_m,
            evaluate=evaluate,
            scale=VALUE_IN_SOLVER / max(abs(start.worth), 1e-9),
        )
        if nlp.motion is not None and start.drive is not None:
            motion = motion_task(problem, self.ground, nlp.motion, start.drive)
            task = replace(task, motion=motion)
        if self._bounded:
            task = self._with_bound(task, situation)
        found: list[Candidate] = []
        for _ in range(REPAIRS):
            begun = perf_counter()
            point = polish_path(nlp, task)
            drive = polished_drive(problem, judge.state, point.inputs)
            path = point.path_m if drive is None else drive.positions_m[1:]
            candidate = replace(
                judge.candidate(path, rung, point.termination, drive),
                lattice_objective=start.worth,
                solve_s=perf_counter() - begun,
                iterations=point.iterations,
                kkt_residual=point.kkt_residual,
                multipliers=point.multipliers,
            )
            if self._lacks(situation, point):
                # It is known to be improvable, and proving that would be dear.
                found.append(candidate)
                task = self._recentred(task, situation, point)
                continue
            if start.clear and start.missing_db == 0.0 and candidate.objective < start.worth:
                # The start will be asked for in its place.
                return [*found, candidate]
            candidate = judge.judged(candidate)
            if candidate.relaxes:
                candidate = replace(candidate, rung=Rung.RELAXED)
            found.append(candidate)
            repaired = self._repaired(task, candidate)
            if repaired is None:
                return found
            task = repaired
        return found

    def _with_bound(self, task: PathTask, situation: Situation) -> PathTask:
        """Ask for the bound where the start keeps it, and for the least missing dB elsewhere.

        A start that keeps the bound with less than is wanted stays feasible.
        """
        wanted, local, exact = self._wanted(task, situation)
        kept = exact >= -MARGIN_TOLERANCE_DB
        return replace(
            task,
            bound_db=np.where(kept, np.minimum(wanted, local), wanted),
            slack_limit_db=np.where(kept, 0.0, np.inf),
            slack_weight=MISSING_DB_COST,
        )

    def _wanted(
        self, task: PathTask, situation: Situation
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """What the local margins must reach for the bound, and local and exact ones at the start.

        Where the local model is too optimistic by e at the start, it is asked for e more, and for
        less where it is not optimistic enough.
        """
        margins = task.evaluate(task.path_m).margins
        if margins is None:
            raise AssertionError("a bounded problem has margins")
        exact = self._margins_db(situation.power(task.path_m))
        return LOCAL_PAD_DB + margins.value - exact, margins.value, exact

    def _lacks(self, situation: Situation, point: Polished) -> bool:
        """Whether a returned path misses the bound where the solver thought that it keeps it."""
        if not self._bounded or not np.isfinite(point.path_m).all():
            return False
        margins = self._margins_db(situation.power(point.path_m))
        return bool((margins[point.slack_db <= GIVEN_UP_DB] < -MARGIN_TOLERANCE_DB).any())

    def _recentred(self, task: PathTask, situation: Situation, point: Polished) -> PathTask:
        """The task from a returned path on: its neighbours, and the error measured there."""
        task = replace(task, path_m=point.path_m, evaluate=local_worth(situation, point.path_m))
        if task.motion is not None:
            drive = polished_drive(self.problem, task.motion.drive.states[0], point.inputs)
            task = replace(task, motion=replace(task.motion, drive=drive))
        return replace(task, bound_db=self._wanted(task, situation)[0])

    def _repaired(self, task: PathTask, candidate: Candidate) -> PathTask | None:
        """The task with the obstacles that a path came too near to built in; None if none."""
        if candidate.sound or not np.isfinite(candidate.path_m).all():
            return None
        lines = lines_with_offenders(
            self.ground.pieces,
            task.lines,
            np.vstack([task.start_m, task.path_m]),
            np.vstack([task.start_m, candidate.path_m]),
            task.clearance_m,
            task.step_length_m,
        )
        return None if lines is None else replace(task, lines=lines)

    def _margins_db(self, power: Prediction) -> NDArray[np.float64]:
        return bound_margin_db(
            power.mean_db,
            power.deviation_db,
            self.problem.stations[0].threshold_dbm,
            self.problem.constraints.p_min,
        )


def _with_effort(chosen: Candidate, tried: list[Candidate]) -> Candidate:
    """Count the solver's time and iterations even where its points were not used."""
    polished = [c for c in tried if c.termination is not Termination.LATTICE_ONLY]
    return replace(
        chosen,
        solve_s=sum(c.solve_s for c in polished),
        iterations=sum(c.iterations for c in polished),
        termination=polished[-1].termination if polished else chosen.termination,
    )
