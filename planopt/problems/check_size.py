"""The lattice of a problem fits into memory: asked before any work is done."""

from __future__ import annotations

from planopt.errors import InputError
from planopt.problems.problem import Problem
from planopt.world.lattice_size import node_estimate

NODE_BYTES, STAGE_BYTES = 1700, 8
"""Memory of a node of the lattice, and of a node at one stage of the horizon, as measured."""

LARGEST_LATTICE_BYTES = 4 * 10**9
"""Limit of the memory that the lattices of all robots take together."""


def check_size(problem: Problem) -> None:
    """Refuse a step so short for the bounds that the search would take many gigabytes.

    Raises
    ------
    InputError
        The estimate is above `LARGEST_LATTICE_BYTES`.
    """
    horizon = problem.planner.horizon
    nodes = sum(
        node_estimate(problem.workspace, robot.speed_max_m_s * problem.planner.step_s)
        for robot in problem.robots
    )
    needed = nodes * (NODE_BYTES + STAGE_BYTES * horizon)
    if needed > LARGEST_LATTICE_BYTES:
        raise InputError(
            f"is {problem.planner.step_s:g}, which for these bounds and speeds makes a lattice of "
            f"{nodes:.2g} nodes; with a horizon of {horizon} it would take "
            f"{needed / 1e9:.2g} GB, more than {LARGEST_LATTICE_BYTES / 1e9:g} GB",
            file=problem.file,
            key="planner.step_s",
            remedy="lengthen the step, or narrow world.bounds_m, or lower planner.horizon",
        )
