"""The step that baseline planners share: a path is released as it is, if it is sound."""

from __future__ import annotations

from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.parts import part_of
from planopt.planning.judge import Judge
from planopt.planning.plan import Plan, Rung, Termination
from planopt.planning.scene import Ground
from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.planning.values.context import StepContext
from planopt.problems.problem import Problem
from planopt.world.clearance import inside_bounds, segments_clear


def released(judge: Judge, path_m: NDArray[np.float64], begun_s: float) -> Plan:
    """The plan of a path (N, 2) that no solver touched, or the one to stand where it is not sound.

    Parameters
    ----------
    judge
        What it is judged by.
    path_m
        Where the steps end.
    begun_s
        When planning began, by :func:`time.perf_counter`.

    Raises
    ------
    InputError
        `path_m` has another shape than (N, 2) of the horizon N.
    """
    part_of("judge", judge, Judge, "give the judge first, then the path")
    shape = (judge.problem.planner.horizon, 2)
    try:
        path_m = np.asarray(path_m, dtype=np.float64)
    except (TypeError, ValueError):
        path_m = np.zeros(0)
    if path_m.shape != shape:
        raise InputError(
            f"has the shape {path_m.shape}, should have {shape}",
            key="path_m",
            remedy="give a place in metres after each step of planner.horizon",
        )
    found = judge.judged(judge.candidate(path_m, Rung.PLAN, Termination.LATTICE_ONLY))
    if not found.sound:
        found = judge.standing(len(path_m))
    return judge.plan_from(found, wall_s=perf_counter() - begun_s)


def free_ends(
    problem: Problem, ground: Ground, position_m: NDArray[np.float64], ends_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return whether the straight way from a place (2,) to each of `ends_m` (n, 2) is free; (n,).

    Raises
    ------
    InputError
        `ends_m` has another shape.
    """
    if np.ndim(ends_m) != 2 or np.shape(ends_m)[1] != 2:
        raise InputError(
            f"has the shape {np.shape(ends_m)}", key="ends_m", remedy="give places (n, 2)"
        )
    starts = np.broadcast_to(position_m, ends_m.shape)
    wanted = problem.constraints.clearance_m + CLEARANCE_PAD_M
    clear = segments_clear(ground.index, starts, ends_m, wanted)
    return inside_bounds(problem.workspace, ends_m) & clear


def held(situation: StepContext, path: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """A path of N steps that begins with `path` and then stands; (N, 2)."""
    horizon = situation.problem.planner.horizon
    last = path[-1] if path else situation.position_m
    return np.asarray([*path, *[last] * (horizon - len(path))])[:horizon]
