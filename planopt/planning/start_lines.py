"""All lines of a start path: from obstacles, from what moves, and from what moves after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.driven import standstill_m
from planopt.planning.programme.offenders import (
    LINE_REACH_STEPS,
    lines_about,
    lines_with_offenders,
    moving_count,
    tail_count,
)
from planopt.problems.problem import Problem
from planopt.robots.braked_motion import braked_motion
from planopt.robots.drive import Drive
from planopt.world.moving_discs import MovingDiscs
from planopt.world.separation import PackedPieces, SeparatingLines, joined_lines, split_lines
from planopt.world.tail_lines import tail_lines


@dataclass(frozen=True, eq=False)
class StartLines:
    """Lines of a start path.

    Attributes
    ----------
    path
        Of its N segments.
    still
        Of where the robot stands after it, from what moves; None where nothing does by then.
    """

    path: SeparatingLines
    still: SeparatingLines | None


def lines_of_start(
    problem: Problem,
    pieces: PackedPieces,
    discs: MovingDiscs,
    path_m: NDArray[np.float64],
    drive: Drive | None,
    count: int,
) -> StartLines:
    """Lines of a start path (N + 1, 2), `count` a segment in all.

    Parameters
    ----------
    problem
        With one robot.
    pieces, discs
        What stands and what moves.
    path_m, drive
        The path, the robot's place first, and how it is driven.
    count
        Lines a segment.
    """
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
    """The lines with what a polished path came too near to put in; None if nothing has none.

    Parameters
    ----------
    problem, pieces, discs
        As in :func:`lines_of_start`.
    lines
        What the result was kept from.
    start_path_m, path_m
        ``(N + 1, 2)`` the path that the lines are of, and the result.
    """
    tail = tail_count(discs, len(path_m) - 1)
    first, last = split_lines(lines, int(lines.piece.shape[1]) - tail)
    found = lines_with_offenders(
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
    """What is not known of where the robot is on its way when, in metres."""
    dynamics = problem.robots[0].dynamics
    return 0.0 if dynamics is None else dynamics.timed_pad_m(problem.planner.step_s)
