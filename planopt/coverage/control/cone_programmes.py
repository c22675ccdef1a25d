# pyright: basic
"""Second-order cone programmes of many agents, solved by Clarabel in blocks.

Few constraints bind. Each programme starts with those that its unconstrained optimum violates and
gains others until its optimum violates none.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK = 50
"""Number of agents in a block: each block takes as many iterations as its hardest programme."""

VIOLATION = 1e-8
"""Constraints that are violated by more than this are added."""

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Programmes:
    """Convex programmes of n agents with V variables in each of two dimensions, z of shape (V, 2).

    Minimise ``1/2 z' hessian z + linear' z``, the same Hessian for both dimensions. Places
    ``place_map @ z + place_offset`` stay in half-planes and discs, and displacements ``way_map @ z
    + way_offset`` are at most as long as `longest`.
    """

    hessian: Floats  # (n, V, V), positive definite
    linear: Floats  # (n, V, 2)
    place_map: Floats  # (n, N, V)
    place_offset: Floats  # (n, N, 2)
    normals: Floats  # (n, K, 2): normal @ place <= room
    rooms: Floats  # (n, K)
    centres: Floats  # (n, D, 2)
    radii: Floats  # (n, D)
    way_map: Floats  # (R, V)
    way_offset: Floats  # (n, R, 2)
    longest: Floats  # (n, R)

    def of(self, agents: NDArray[np.intp]) -> Programmes:
        """Return the programmes of some agents."""
        every = {each.name: getattr(self, each.name) for each in fields(self)}
        return Programmes(**{k: v if k == "way_map" else v[agents] for k, v in every.items()})


def solve_programmes(given: Programmes) -> Floats | None:
    """Return the optima ``(n, V, 2)``, or None if Clarabel fails."""
    best = np.asarray(np.linalg.solve(given.hessian, -given.linear), dtype=np.float64)
    todo = np.arange(len(best))
    active = tuple(np.zeros_like(each) for each in _violated(given, best))
    while True:
        violated = _violated(given.of(todo), best[todo])
        new = [mask & ~known[todo] for mask, known in zip(violated, active, strict=True)]
        left = np.any([mask.any(axis=tuple(range(1, mask.ndim))) for mask in new], axis=0)
        if not left.any():
            return best
        for mask, known in zip(new, active, strict=True):
            known[todo] |= mask
        todo = todo[left]
        for start in range(0, len(todo), BLOCK):
            agents = todo[start : start + BLOCK]
            found = _solve_block(given.of(agents), *(known[agents] for known in active))
            if found is None:
                return None
            best[agents] = found


def _violated(given: Programmes, z: Floats) -> tuple[Mask, Mask, Mask]:
    """Return which half-planes (n, K, N), discs (n, D, N) and lengths (n, R) z violates."""
    places = given.place_map @ z + given.place_offset
    heights = given.normals @ places.transpose(0, 2, 1) - given.rooms[..., None]
    away = np.linalg.norm(places[:, None] - given.centres[:, :, None], axis=3)
    lengths = np.linalg.norm(given.way_map @ z + given.way_offset, axis=2)
    return (
        heights > VIOLATION,
        away - given.radii[..., None] > VIOLATION,
        lengths - given.longest > VIOLATION,
    )


def _solve_block(given: Programmes, planes: Mask, discs: Mask, ways: Mask) -> Floats | None:
    """Return the optima (n, V, 2) under some of the constraints by one sparse programme."""
    import clarabel
    from scipy.sparse import coo_array, csc_array

    count, size = given.linear.shape[:2]
    agent, plane, step = np.nonzero(planes)
    normals, offsets = given.normals[agent, plane], given.place_offset[agent, step]
    flat = given.place_map[agent, step][:, :, None] * normals[:, None]
    rooms = given.rooms[agent, plane] - (normals * offsets).sum(axis=1)
    disc_agent, disc, disc_step = np.nonzero(discs)
    way_agent, way = np.nonzero(ways)
    # Cones are (radius, offset - matrix @ z).
    matrix = np.concatenate((given.place_map[disc_agent, disc_step], given.way_map[way]))
    from_centre = given.place_offset[disc_agent, disc_step] - given.centres[disc_agent, disc]
    offset = np.concatenate((from_centre, given.way_offset[way_agent, way]))
    radius = np.concatenate((given.radii[disc_agent, disc], given.longest[way_agent, way]))
    round_rows = np.zeros((len(matrix), 3, size, 2))
    round_rows[:, 1, :, 0] = round_rows[:, 2, :, 1] = -matrix
    rows = np.concatenate((flat, round_rows.reshape(-1, size, 2))).reshape(-1, 2 * size)
    of_row = np.concatenate((agent, np.repeat(np.concatenate((disc_agent, way_agent)), 3)))
    sides = np.concatenate((rooms, np.column_stack((radius, offset)).ravel()))
    hessian = np.einsum("ivw,xy->ivxwy", given.hessian, np.eye(2)).reshape(-1, 2 * size)
    upper = hessian * np.tile(np.triu(np.ones((2 * size, 2 * size))), (count, 1))

    def sparse(dense: Floats, owner: NDArray[np.intp]) -> Any:
        """Return rows (m, 2 V) of agents in the columns of all agents."""
        row, column = np.nonzero(dense)
        at = row, owner[row] * 2 * size + column
        return csc_array(coo_array((dense[row, column], at), (len(dense), count * 2 * size)))

    settings = clarabel.DefaultSettings()  # pyright: ignore[reportAttributeAccessIssue]
    settings.verbose = False
    settings.max_threads = 1
    cones = [clarabel.NonnegativeConeT(len(rooms))]  # pyright: ignore[reportAttributeAccessIssue]
    cones += [clarabel.SecondOrderConeT(3)] * len(matrix)  # pyright: ignore[reportAttributeAccessIssue]
    solution: Any = clarabel.DefaultSolver(  # pyright: ignore[reportAttributeAccessIssue]
        sparse(upper, np.repeat(np.arange(count), 2 * size)), given.linear.ravel(),
        sparse(rows, of_row), sides, cones, settings,
    ).solve()  # fmt: skip
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        return None
    return np.asarray(solution.x, dtype=np.float64).reshape(count, size, 2)
