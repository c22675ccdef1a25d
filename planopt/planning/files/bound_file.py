"""Certificates of bounds in ``bound.npz``: a potential on a mesh for each robot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from planopt.bounds.bound import Potential
from planopt.errors import InputError
from planopt.files.npz import read_npz
from planopt.files.tables import REMEDY
from planopt.planning.files.belief_file import Arrays
from planopt.planning.plan import Plan

BOUND_FILE = "bound.npz"

KINDS = {
    "nodes_m": ("f", 2),
    "corners": ("iu", 3),
    "at_nodes": ("f", None),
    "at_sides": ("f", None),
}
"""Types of the arrays of a potential, and their numbers of columns."""


def bound_arrays(plans: Sequence[Plan]) -> Arrays:
    """Return the arrays of the potentials of plans, by the number of the robot."""
    return {
        f"{number}_{name}": getattr(plan.bound.certificate, name)
        for number, plan in enumerate(plans)
        if plan.bound is not None and plan.bound.certificate is not None
        for name in KINDS
    }


def read_potentials(path: Path, count: int) -> tuple[Potential | None, ...]:
    """Return the potential of each of `count` robots; None for those without."""
    if not path.is_file():
        return (None,) * count
    arrays = read_npz(path)
    return tuple(_potential(path, arrays, number) for number in range(count))


def _potential(path: Path, arrays: Arrays, number: int) -> Potential | None:
    names = {name: f"{number}_{name}" for name in KINDS}
    if not any(key in arrays for key in names.values()):
        return None
    for name, (kinds, columns) in KINDS.items():
        key = names[name]
        if key not in arrays:
            raise InputError("the array is missing", file=path, key=key, remedy=REMEDY)
        shape = arrays[key].shape
        fits = len(shape) == 1 if columns is None else shape[1:] == (columns,)
        if not fits or arrays[key].dtype.kind not in kinds or not len(arrays[key]):
            message = f"an array of shape {shape} and type {arrays[key].dtype} does not fit"
            raise InputError(message, file=path, key=key, remedy=REMEDY)
    nodes, at_nodes, at_sides = (
        np.asarray(arrays[names[name]], dtype=np.float64)
        for name in ("nodes_m", "at_nodes", "at_sides")
    )
    corners = np.asarray(arrays[names["corners"]], dtype=np.intp)
    return Potential(nodes, corners, at_nodes, at_sides)
