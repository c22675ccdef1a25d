"""One receding-horizon step for a sum of terms: global starts, polish, guard, proof, ladder."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np

from planopt.planning.budget import Budget, budget_from
from planopt.planning.candidate import Candidate
from planopt.planning.driven import (
    driven_starts,
    motion_shape,
    motion_task,
    polished_drive,
    without_start,
)
from planopt.planning.ground import Ground
from planopt.planning.judge import Judge
from planopt.planning.plan import Plan, Rung, Termination, Verdict
from planopt.planning.programme.methods import METHODS
from planopt.planning.programme.offenders import (
    MOVING_LINES,
    REPAIRS,
    lines_about,
    lines_with_offenders,
    moving_count,
)
from planopt.planning.programme.path_nlp import PathNlp, build_path_nlp
from planopt.planning.programme.path_polish import PathTask, polish_path
from planopt.planning.programme.path_shape import PathShape
from planopt.planning.rule_bounds import lacks, moved, recentred, rows_again, with_bounds
from planopt.planning.search.good_place import ways_to_good_place
from planopt.planning.search.start_search import COUPLED_STARTS, Start, StartSearch
from planopt.planning.shifted import shifted_path
from planopt.planning.worth.local_worth import local_worth
from planopt.planning.worth.risk_allocation import Allocation
from planopt.planning.worth.rule_rows import has_step_rows, has_sum_row, rule_rows
from planopt.planning.worth.rule_worth import rule_missing
from planopt.planning.worth.situation import Situation
from planopt.planning.worth.structure import structure_of
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive

LINES_PER_SEGMENT = 2
"""Nearest convex pieces that each segment is kept from; the verifier looks at all (fast.md)."""

ALLOCATIONS = 6
"""How often the risk of all steps together is shared out again, each with a polish."""

VALUE_IN_SOLVER = 10.0
"""What the start's worth counts in the solver, whatever its unit: its tolerances are absolute."""

RETURNED = frozenset((Termination.CONVERGED, Termination.ACCEPTABLE))
"""Where another solve may go on from the point; what a failed one leaves may be anywhere."""


class HorizonPlanner:
    """Plans for one robot of a problem whose objective is a sum of terms.

    Parameters
    ----------
    problem
        With one robot; its planner settings say how.
    ground
        Its geometry.
    thorough
        Follow starts of several parts of the reachable places, polish the best twice, and take it,
        instead of the first that is verified.
    """

    def __init__(self, problem: Problem, ground: Ground, thorough: bool = False) -> None:
        self._thorough = thorough
        self.problem = problem
        self.ground = ground
        self._search = StartSearch(problem, ground, thorough)
        coupled = structure_of(problem) == "full" and problem.planner.horizon > 1
        self._followed = COUPLED_STARTS if coupled else 1
        self._driven = problem.robots[0].dynamics is not None
        self._nlp: PathNlp | None = None
        self._built: dict[int, PathNlp] = {}
        self._fit_lines(min(len(problem.workspace.moving), MOVING_LINES))

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
        self._fit_lines(moving_count(situation.circumstances.moving))
        shifted = shifted_path(self.problem, judge.index, situation.position_m, warm)
        starts = self._search.find_starts(situation, shifted)
        if self._driven:
            starts = driven_starts(judge, situation, starts, warm)
        budget = budget_from(self.problem, begun)
        chosen = self._climb(situation, judge, starts, warm, budget)
        return judge.plan_from(chosen, wall_s=perf_counter() - begun)

    def _fit_lines(self, moving: int) -> None:
        """Use the programme with so many lines for what moves, built when first asked for."""
        settings = self.problem.planner
        if settings.name not in METHODS:
            return
        if moving not in self._built:
            lines = LINES_PER_SEGMENT + moving
            shape = PathShape(
                settings.horizon,
                lines,
                structure_of(self.problem),
                has_step_rows(self.problem),
                has_sum_row(self.problem),
                motion_shape(self.problem, lines),
            )
            self._built[moving] = build_path_nlp(
                shape, METHODS[settings.name], settings.budget_s, until_settled=True
            )
        self._nlp = self._built[moving]

    def _climb(
        self,
        situation: Situation,
        judge: Judge,
        starts: list[Start],
        warm: Plan | None,
        budget: Budget,
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
                rung = Rung.PLAN if number < self._followed or self._driven else Rung.COLD_RETRY
                for candidate in self.polished(situation, judge, start, rung, budget):
                    if candidate.verdict is Verdict.VERIFIED:
                        verified.append(candidate)
                    tried.append(candidate)
                if budget.spent and not verified:
                    unpolished = replace(unpolished, termination=Termination.TIME_LIMIT)
            if any(c.sound and c.hopeless for c in tried):
                break
            if not any(c.objective >= unpolished.objective for c in verified):
                unpolished = judge.judged(unpolished)
                tried.append(unpolished)
                if unpolished.verdict is Verdict.VERIFIED:
                    verified.append(unpolished)
            settled = number + 1 >= self._followed and not (self._thorough or self._driven)
            if verified and settled:
                break
        if not verified and not self._driven:
            found = self._by_way_to_good_place(situation, judge, tried, budget)
            verified += [c for c in found if c.verdict is Verdict.VERIFIED]
            tried += found
        if verified and self._thorough and self._nlp is not None:
            found = self._once_more(situation, judge, starts, verified, budget)
            verified += [c for c in found if c.verdict is Verdict.VERIFIED]
            tried += found
        if verified:
            return _with_effort(max(verified, key=lambda c: c.objective), tried)
        # Nothing is verified. Connectivity may be given up, clearance and speed never.
        sound = [candidate for candidate in tried if candidate.sound]
        if self._driven:
            sound.sort(key=lambda candidate: candidate.missing_db)
        if any(candidate.hopeless for candidate in sound):
            return _with_effort(sound[0], tried)
        fallback = self._without_start(judge, warm)
        chosen = fallback if fallback.verdict is Verdict.VERIFIED or not sound else sound[0]
        return _with_effort(chosen, tried)

    def _by_way_to_good_place(
        self, situation: Situation, judge: Judge, tried: list[Candidate], budget: Budget
    ) -> list[Candidate]:
        """Go straight to a place that the verifier says was missed."""
        found: list[Candidate] = []
        for path in ways_to_good_place(judge, tried):
            way = judge.candidate(path, Rung.COLD_RETRY, Termination.LATTICE_ONLY)
            if self._nlp is not None:
                start = Start(path, way.objective, rule_missing(situation, path))
                polished = self.polished(situation, judge, start, Rung.COLD_RETRY, budget)
                found += [replace(candidate, rung=Rung.COLD_RETRY) for candidate in polished]
            found.append(judge.judged(way))
            if any(candidate.verdict is Verdict.VERIFIED for candidate in found):
                break
        return found

    def _once_more(
        self,
        situation: Situation,
        judge: Judge,
        starts: list[Start],
        verified: list[Candidate],
        budget: Budget,
    ) -> list[Candidate]:
        """Polish the best again, from the measurements and sides of obstacles nearest to it."""
        best = max(verified, key=lambda candidate: candidate.objective)
        again = Start(best.path_m, starts[0].worth, missing_db=0.0)
        rung = best.rung if best.rung is Rung.COLD_RETRY else Rung.PLAN
        return self.polished(situation, judge, again, rung, budget)

    def _without_start(self, judge: Judge, warm: Plan | None) -> Candidate:
        """Take the last verified plan, shifted and checked again; else stop."""
        if self._driven:
            return without_start(judge, warm)
        path = shifted_path(self.problem, judge.index, judge.position_m, warm)
        if path is not None:
            shifted = judge.judged(judge.candidate(path, Rung.SHIFTED, Termination.STOPPED))
            if shifted.verdict is Verdict.VERIFIED:
                return shifted
        return judge.standing(self.problem.planner.horizon)

    def polished(
        self,
        situation: Situation,
        judge: Judge,
        start: Start,
        rung: Rung,
        budget: Budget | None = None,
    ) -> list[Candidate]:
        """Candidates that a start leads to, judged: what the proof objects to is built in.

        None once the budget is spent.
        """
        budget = Budget() if budget is None else budget
        problem, nlp = self.problem, self._nlp
        if nlp is None:
            raise AssertionError("this planner does not polish")
        if budget.spent:
            return []
        rows = rule_rows(situation, start.path_m)
        evaluate = local_worth(situation, start.path_m, rows)
        ends = np.vstack([situation.position_m, start.path_m])
        task = PathTask(
            start_m=situation.position_m,
            path_m=start.path_m,
            lines=lines_about(
                self.ground.pieces,
                situation.circumstances.moving,
                ends,
                nlp.shape.lines,
                problem.constraints.clearance_m,
                problem.step_length_m,
            ),
            clearance_m=problem.constraints.clearance_m,
            step_length_m=problem.step_length_m,
            bounds_m=problem.workspace.bounds_m,
            evaluate=evaluate,
            scale=VALUE_IN_SOLVER / max(abs(start.worth), 1e-9),
        )
        if nlp.shape.motion is not None and start.drive is not None:
            motion = motion_task(problem, self.ground, nlp.shape.motion, start.drive)
            task = replace(task, motion=motion)
        task = with_bounds(task, situation, rows)
        allocations = ALLOCATIONS if problem.constraints.rule.connectivity == "joint" else 0
        found: list[Candidate] = []
        tried: list[Allocation] = []
        for _ in range(REPAIRS + allocations):
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
            if lacks(situation, rows, point):
                # It is known to be improvable, and proving that would be dear.
                found.append(candidate)
                if budget.spent or point.termination not in RETURNED:
                    return found
                task = _driven_from(recentred(task, situation, rows, point), drive)
                continue
            improvable = start.clear and start.missing_db == 0.0 and not allocations
            if improvable and candidate.objective < start.worth:
                # The start will be asked for in its place.
                return [*found, candidate]
            candidate = judge.judged(candidate)
            if candidate.relaxes:
                candidate = replace(candidate, rung=Rung.RELAXED)
            found.append(candidate)
            repaired = self._repaired(task, situation, candidate)
            if budget.spent:
                return found
            if repaired is not None:
                task = repaired
                continue
            again = rows_again(situation, rows, candidate, tried) if allocations else None
            if again is None:
                return found
            rows, allocations = again, allocations - 1
            task = _driven_from(moved(task, situation, rows, candidate.path_m), drive)
            task = with_bounds(task, situation, rows)
        return found

    def _repaired(
        self, task: PathTask, situation: Situation, candidate: Candidate
    ) -> PathTask | None:
        """The task with what a path came too near to built in; None if nothing."""
        if candidate.sound or not np.isfinite(candidate.path_m).all():
            return None
        lines = lines_with_offenders(
            self.ground.pieces,
            task.lines,
            np.vstack([task.start_m, task.path_m]),
            np.vstack([task.start_m, candidate.path_m]),
            task.clearance_m,
            task.step_length_m,
            situation.circumstances.moving,
        )
        return None if lines is None else replace(task, lines=lines)


def _driven_from(task: PathTask, drive: Drive | None) -> PathTask:
    """The task from a drive on; as it is for the single integrator."""
    if task.motion is None or drive is None:
        return task
    return replace(task, motion=replace(task.motion, drive=drive))


def _with_effort(chosen: Candidate, tried: list[Candidate]) -> Candidate:
    """Count the solver's time and iterations even where its points were not used."""
    polished = [c for c in tried if c.termination is not Termination.LATTICE_ONLY]
    return replace(
        chosen,
        solve_s=sum(c.solve_s for c in polished),
        iterations=sum(c.iterations for c in polished),
        termination=polished[-1].termination if polished else chosen.termination,
    )
