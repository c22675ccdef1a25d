"""Initial guesses and refinement tasks of a robot with dynamics.

The search finds paths for a single integrator. Inputs that follow such a path give an initial
guess, which may violate clearance at corners. The remainder of the previous plan, then braking, is
always feasible.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.candidates import Scorer, drive_candidate
from planopt.planning.plan import Plan, Rung, Termination, Verdict, shifted_drive
from planopt.planning.programme.clearance_lines import LINE_REACH_STEPS
from planopt.planning.programme.path_polish import MotionTask
from planopt.planning.programme.path_rows import MotionShape
from planopt.planning.proof.motion import swept_motion, verify_apart, verify_motion
from planopt.planning.scene import Ground
from planopt.planning.search.guess_search import Guess
from planopt.planning.values.context import StepContext
from planopt.planning.values.objective_value import rule_missing
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive, rolled_out
from planopt.world.separation import SeparatingLines, joined_lines, separating_lines


def motion_shape(problem: Problem, lines: int) -> MotionShape | None:
    """Return the structure of the rows of the dynamics; None for the single integrator."""
    robot = problem.robots[0]
    if robot.moves_freely:
        return None
    return MotionShape(robot.dynamics, problem.planner.step_s, problem.planner.horizon, lines)


def driven_starts(
    scorer: Scorer, context: StepContext, starts: list[Guess], warm: Plan | None
) -> list[Guess]:
    """Return drivable guesses, best first, followed by those that violate clearance."""
    problem = scorer.problem
    dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s
    found: list[Guess] = []
    for start in starts:
        inputs = dynamics.following(scorer.state, start.path_m, step_s)
        drive = rolled_out(dynamics, scorer.state, inputs, step_s)
        found.append(driven_start(scorer, context, drive))
    last = last_drive(problem, warm)
    if last is not None:
        found.append(driven_start(scorer, context, last))
    found.sort(key=lambda start: (not start.clear, round(start.missing_db, 2), -start.value))
    return found


def last_drive(problem: Problem, warm: Plan | None) -> Drive | None:
    """Return the remainder of a verified previous plan, then braking; None if there is none."""
    shifted = shifted_drive(problem, warm)
    if shifted is None or warm is None or warm.verdict is not Verdict.VERIFIED:
        return None
    return shifted if len(shifted.inputs) == problem.planner.horizon else None


def driven_start(scorer: Scorer, context: StepContext, drive: Drive) -> Guess:
    """Return a drive as an initial guess."""
    candidate = drive_candidate(scorer, drive, Rung.LATTICE, Termination.LATTICE_ONLY)
    path = candidate.path_m
    moved = verify_motion(scorer.problem, scorer.index, scorer.state, drive.positions_m, drive)
    swept = swept_motion(scorer.problem, drive.positions_m, drive)
    apart = verify_apart(scorer.context.moving, swept)
    clear = not (moved.reasons or apart.reasons)
    missing = rule_missing(context, path)
    return Guess(path, scorer.worth(candidate), missing, drive, clear)


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


def refined_drive(
    problem: Problem, state: NDArray[np.float64], inputs: NDArray[np.float64] | None
) -> Drive | None:
    """Return the trajectory of a solver's inputs; None for the single integrator."""
    if inputs is None:
        return None
    return rolled_out(problem.robots[0].dynamics, state, inputs, problem.planner.step_s)
