"""Nav2 masks of the channel belief of a problem."""

from __future__ import annotations

from pathlib import Path

from planopt.channel.channel_map import PosteriorMap, default_cell_m, serving_map
from planopt.channel.posterior import Belief
from planopt.problems.problem import Problem
from planopt.world.nav2_masks import MaskLimits, write_masks


def limits_of(problem: Problem, keepout_below: float, p_min: float | None) -> MaskLimits:
    """Return the limits of the masks; `p_min` defaults to the problem's, if it has one."""
    if p_min is not None:
        return MaskLimits(keepout_below, p_min)
    own = problem.constraints.p_min
    return MaskLimits(keepout_below, own) if own > 0.0 else MaskLimits(keepout_below)


def believed_map(problem: Problem, belief: Belief, cell_m: float | None = None) -> PosteriorMap:
    """Return the predicted best-server map of a problem's workspace."""
    bounds = problem.workspace.bounds_m
    thresholds = [station.threshold_dbm for station in problem.stations]
    cell = default_cell_m(bounds) if cell_m is None else cell_m
    return serving_map(belief.posteriors, bounds, cell, thresholds)


def save_masks(
    problem: Problem, belief: Belief, folder: Path, limits: MaskLimits, cell_m: float | None
) -> None:
    """Write the Nav2 masks of a channel belief into a folder."""
    write_masks(folder, believed_map(problem, belief, cell_m).connectivity, limits)
