"""Refine an initial guess into candidates, with the verifier's objections built in.

Separating lines of a guess: from obstacles, from moving obstacles, and from these after it ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.planning.candidates import Budget, Candidate, Judge, solve_limit_s
from planopt.planning.certificate import RuleResult
from planopt.planning.driven import motion_shape, motion_task, refined_drive, standstill_m
from planopt.planning.plan import Rung, Termination
from planopt.planning.programme.clearance_lines import (
    LINE_REACH_STEPS,
    REPAIRS,
    lines_about,
    lines_with_violated,
    moving_count,
    tail_count,
)
from planopt.planning.programme.path_nlp import METHODS, PathNlp, build_path_nlp, near_start
from planopt.planning.programme.path_polish import PathTask, polish_path
from planopt.planning.programme.path_rows import PathShape
from planopt.planning.proof.context import obstacles_ahead
from planopt.planning.proof.rule import rule_of
from planopt.planning.rule_bounds import lacks, moved, recentred, with_bounds
from planopt.planning.scene import Ground
from planopt.planning.search.guess_search import Guess
from planopt.planning.values.context import StepContext, structure_of
from planopt.planning.values.local_value import local_value
from planopt.planning.values.rule_rows import has_step_rows, has_sum_row, rows_again, rule_rows
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive, braked_motion
from planopt.world.moving_discs import MovingDiscs
from planopt.world.separation import (
    PackedPieces,
    SeparatingLines,
    joined_lines,
    split_lines,
    tail_lines,
)


@dataclass(frozen=True, eq=False)
class StartLines:
    """Lines of a start path."""

    path: SeparatingLines  # Of its N segments
    # Of where the robot stands after it, from what moves; None where nothing does by then
    still: SeparatingLines | None


def lines_of_start(
    problem: Problem,
    pieces: PackedPieces,
    discs: MovingDiscs,
    path_m: NDArray[np.float64],
    drive: Drive | None,
    count: int,
) -> StartLines:
    """Lines of a start path (N + 1, 2), `count` a segment in all."""
    clearance, step_length = problem.constraints.clearance_m, problem.step_length_m
    horizon = len(path_m) - 1
    tail = tail_count(discs, horizon)
    lines = lines_about(
        pieces, discs, path_m, count - tail, clearance, step_length, timed_pad_m(problem)
    )
    if not tail:
        return StartLines(lines, None)
    end = path_m[-1] if drive is None else standstill_m(problem, drive.states[-1])
    last, still = tail_lines(
        discs,
        braked_motion(path_m, drive, problem.planner.step_s),
        horizon,
        end,
        clearance,
        tail,
        LINE_REACH_STEPS * step_length,
    )
    return StartLines(joined_lines(lines, last), still)


def lines_repaired(
    problem: Problem,
    pieces: PackedPieces,
    discs: MovingDiscs,
    lines: SeparatingLines,
    start_path_m: NDArray[np.float64],
    path_m: NDArray[np.float64],
) -> SeparatingLines | None:
    """The lines with what a refined path came too near to put in; None if nothing has none."""
    # Shapes: start_path_m, path_m (N + 1, 2).
    tail = tail_count(discs, len(path_m) - 1)
    first, last = split_lines(lines, int(lines.piece.shape[1]) - tail)
    found = lines_with_violated(
        pieces,
        first,
        start_path_m,
        path_m,
        problem.constraints.clearance_m,
        problem.step_length_m,
        discs,
        timed_pad_m(problem),
    )
    return found if found is None or not tail else joined_lines(found, last)


def lines_count(standing: int, discs: MovingDiscs, horizon: int) -> int:
    """Lines a segment with `standing` ones from obstacles."""
    return standing + moving_count(discs) + tail_count(discs, horizon)


def timed_pad_m(problem: Problem) -> float:
    """Return the uncertainty of where the robot is on its way at a time, in metres."""
    return problem.robots[0].dynamics.timed_pad_m(problem.planner.step_s)


LINES_PER_SEGMENT = 2
"""Nearest convex pieces that each segment is kept from; the verifier looks at all."""

ALLOCATIONS = 6
"""How often the risk of all steps together is shared out again, each with a refinement."""

VALUE_IN_SOLVER = 10.0
"""What the start's worth counts in the solver, whatever its unit: its tolerances are absolute. A
start that is worth nothing says nothing of the unit."""

RETURNED = frozenset((Termination.CONVERGED, Termination.ACCEPTABLE))
"""Where another solve may go on from the point; what a failed one leaves may be anywhere."""


class GuessRefinement:
    """Polishes starts of one problem; keeps the solvers that it has built."""

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem = problem
        self._ground = ground
        self._built: dict[int, PathNlp] = {}
        self._nlp_for(obstacles_ahead(problem, 0))

    def _nlp_for(self, discs: MovingDiscs) -> PathNlp:
        """The programme with lines for so much that moves, built when first asked for."""
        settings = self._problem.planner
        lines = lines_count(LINES_PER_SEGMENT, discs, settings.horizon)
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
        situation: StepContext,
        judge: Judge,
        start: Guess,
        rung: Rung,
        budget: Budget | None = None,
    ) -> list[Candidate]:
        """Return the judged candidates of a start; none once the budget is spent."""
        budget = Budget() if budget is None else budget
        problem, moving = self._problem, situation.moving
        nlp = self._nlp_for(moving)
        if budget.spent:
            return []
        rows = rule_rows(situation, start.path_m)
        evaluate = local_value(situation, start.path_m, rows)
        ends = np.vstack([situation.position_m, start.path_m])
        lines = lines_of_start(
            problem, self._ground.pieces, moving, ends, start.drive, nlp.shape.lines
        )
        task = PathTask(
            start_m=situation.position_m,
            path_m=start.path_m,
            lines=lines.path,
            clearance_m=problem.constraints.clearance_m,
            step_length_m=problem.step_length_m,
            bounds_m=problem.workspace.bounds_m,
            evaluate=evaluate,
            scale=VALUE_IN_SOLVER / (abs(_counted(problem, start)) or VALUE_IN_SOLVER),
        )
        if nlp.shape.motion is not None and start.drive is not None:
            motion = motion_task(problem, self._ground, nlp.shape.motion, start.drive, lines.still)
            task = replace(task, motion=motion, charge=start.charge)
        task = with_bounds(task, situation, rows)
        correlates = rule_of(problem).correlates(problem.constraints.p_min)
        allocations = ALLOCATIONS if correlates else 0
        found: list[Candidate] = []
        tried: list[tuple[float, RuleResult]] = []
        for attempt in range(REPAIRS + allocations):
            begun = perf_counter()
            point = polish_path(nlp, task)
            drive = refined_drive(problem, judge.state, point.inputs)
            path = point.path_m if drive is None else drive.positions_m[1:]
            candidate = replace(
                judge.candidate(path, rung, point.termination, drive),
                lattice_objective=judge.sense * start.value,
                solve_s=perf_counter() - begun,
                iterations=point.iterations,
                kkt_residual=point.kkt_residual,
                multipliers=point.multipliers,
            )
            if lacks(situation, rows, point, firmly=attempt == 0):
                # It is known to be improvable, and proving that would be dear.
                found.append(candidate)
                if budget.spent or point.termination not in RETURNED:
                    return found
                task = _driven_from(recentred(task, situation, rows, point), drive)
                continue
            improvable = start.clear and start.missing_db == 0.0 and not allocations
            if improvable and judge.worth(candidate) < start.value:
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
            result = None if candidate.certificate is None else candidate.certificate.rule
            if not allocations or result is None:
                return found
            again = rows_again(situation, rows, candidate.path_m, tried, result)
            if again is None:
                return found
            rows, allocations = again, allocations - 1
            task = _driven_from(moved(task, situation, rows, candidate.path_m), drive)
            task = with_bounds(task, situation, rows)
        return found

    def _repaired(
        self, task: PathTask, situation: StepContext, candidate: Candidate
    ) -> PathTask | None:
        """The task with what a path came too near to built in; None if nothing."""
        if candidate.sound or not np.isfinite(candidate.path_m).all():
            return None
        lines = lines_repaired(
            self._problem,
            self._ground.pieces,
            situation.moving,
            task.lines,
            np.vstack([task.start_m, task.path_m]),
            np.vstack([task.start_m, candidate.path_m]),
        )
        if lines is not None:
            return replace(task, lines=lines)
        if candidate.drive is not None:
            return self._about(task, situation, candidate.path_m, candidate.drive)
        return None

    def _about(
        self, task: PathTask, situation: StepContext, path_m: NDArray[np.float64], drive: Drive
    ) -> PathTask:
        """The task from a drive on, with lines about its way and its way of stopping.

        A curve comes too near beside its chord, or in stopping: the lines of the start do not tell.
        """
        if task.motion is None:
            raise AssertionError("a single integrator has no drive")
        problem = self._problem
        lines = lines_of_start(
            problem,
            self._ground.pieces,
            situation.moving,
            np.vstack([task.start_m, path_m]),
            drive,
            task.motion.shape.lines,
        )
        motion = motion_task(problem, self._ground, task.motion.shape, drive, lines.still)
        return replace(task, path_m=path_m, lines=lines.path, motion=motion)


def _counted(problem: Problem, start: Guess) -> float:
    """Return the value at which the solver's is counted; of a goal, the time of all steps."""
    return start.value if start.charge is None else problem.planner.step_s * len(start.path_m)


def _driven_from(task: PathTask, drive: Drive | None) -> PathTask:
    """The task from a drive on; as it is for the single integrator."""
    if task.motion is None or drive is None:
        return task
    return replace(task, motion=replace(task.motion, drive=drive))
