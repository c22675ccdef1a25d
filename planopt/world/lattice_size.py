"""Spacing and size of the lattice that paths are searched on."""

from __future__ import annotations

import math

from planopt.world.workspace import Workspace

LONGEST_MOVE = math.sqrt(5.0)
"""Length of the longest move in spacings."""


def node_estimate(workspace: Workspace, step_m: float) -> float:
    """Return about how many nodes a lattice for steps of `step_m` has within the bounds."""
    x_min, y_min, x_max, y_max = workspace.bounds_m
    spacing = step_m / LONGEST_MOVE
    return (x_max - x_min) / spacing * ((y_max - y_min) / spacing)
