"""Nav2 masks of the channel belief of a problem."""

from __future__ import annotations

from pathlib import Path

from planopt.channel.channel_map import default_cell_m, serving_map
from planopt.channel.posterior import Belief
from planopt.problems.problem import Problem
from planopt.world.nav2_masks import MaskLimits, write_masks


def save_masks(
    problem: Problem,
    belief: Belief,
    folder: Path,
    keepout_below: float,
    p_min: float | None,
    cell_m: float | None,
) -> None:
    """Write the masks; `p_min` is by default that of the problem, if it has one."""
    asked = problem.constraints.p_min or None if p_min is None else p_min
    limits = MaskLimits(keepout_below) if asked is None else MaskLimits(keepout_below, asked)
    bounds = problem.workspace.bounds_m
    thresholds = [station.threshold_dbm for station in problem.stations]
    cell = default_cell_m(bounds) if cell_m is None else cell_m
    found = serving_map(belief.posteriors, bounds, cell, thresholds)
    write_masks(folder, found.connectivity, limits)
