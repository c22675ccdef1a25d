"""Optimal control problems of the agents as convex programmes, scaled by each agent's distances."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.coverage.control.safe_sets import SafeSets

BLOCK = 50
"""Number of agents solved together; a block needs the iterations of its hardest programme."""
VIOLATION = 1e-8  # Violation above which a constraint is added to the programme
WITHIN = 1e-6  # Relative margin of speed and acceleration limits for the tolerance of the solver
LEAST_UNIT = 1e-3  # Minimum length unit of an agent as a share of the largest one
NO_LIMIT = 1e3  # Radius, in scaled lengths, of inactive discs that pad the constraint tables


@dataclass(frozen=True, eq=False)
class Programmes:
    """Convex programmes of n agents with variables z of shape (V, 2) each."""

    # Minimise ``1/2 z' hessian z + linear' z`` with the same Hessian for both dimensions. Positions
    # ``place_map @ z + place_offset`` stay in half-planes and discs. Displacements ``move_map @ z +
    # move_offset`` have at most the length `longest`.

    hessian: Floats  # (n, V, V), positive definite
    linear: Floats  # (n, V, 2)
    place_map: Floats  # (n, N, V)
    place_offset: Floats  # (n, N, 2)
    normals: Floats  # (n, K, 2): normal @ place <= room
    rooms: Floats  # (n, K)
    centres: Floats  # (n, D, 2)
    radii: Floats  # (n, D)
    move_map: Floats  # (R, V)
    move_offset: Floats  # (n, R, 2)
    longest: Floats  # (n, R)

    def of(self, agents: Indices) -> Programmes:
        """Return the programmes of the selected agents."""
        every = {each.name: getattr(self, each.name) for each in fields(self)}
        return Programmes(**{k: v if k == "move_map" else v[agents] for k, v in every.items()})


def solve_programmes(programmes: Programmes) -> Floats | None:
    """Return the solutions ``(n, V, 2)``, or None if Clarabel fails."""
    best = np.asarray(np.linalg.solve(programmes.hessian, -programmes.linear), dtype=np.float64)
    todo = np.arange(len(best))
    active = tuple(np.zeros_like(each) for each in _violated(programmes, best))
    while True:
        violated = _violated(programmes.of(todo), best[todo])
        new = [mask & ~known[todo] for mask, known in zip(violated, active, strict=True)]
        left = np.any([mask.any(axis=tuple(range(1, mask.ndim))) for mask in new], axis=0)
        if not left.any():
            return best
        for mask, known in zip(new, active, strict=True):
            known[todo] |= mask
        todo = todo[left]
        for start in range(0, len(todo), BLOCK):
            agents = todo[start : start + BLOCK]
            found = _solve_block(programmes.of(agents), *(known[agents] for known in active))
            if found is None:
                return None
            best[agents] = found


def _violated(programmes: Programmes, z: Floats) -> tuple[Mask, Mask, Mask]:
    """Return masks of the half-planes, of the discs and of the length limits that `z` violates."""
    places = programmes.place_map @ z + programmes.place_offset
    heights = programmes.normals @ places.transpose(0, 2, 1) - programmes.rooms[..., None]
    away = np.linalg.norm(places[:, None] - programmes.centres[:, :, None], axis=3)
    lengths = np.linalg.norm(programmes.move_map @ z + programmes.move_offset, axis=2)
    return (
        heights > VIOLATION,
        away - programmes.radii[..., None] > VIOLATION,
        lengths - programmes.longest > VIOLATION,
    )


def _solve_block(programmes: Programmes, planes: Mask, discs: Mask, moves: Mask) -> Floats | None:
    """Solve one sparse programme with the selected constraints; return solutions (n, V, 2)."""
    import clarabel
    from scipy.sparse import coo_array, csc_array

    count = len(programmes.linear)
    size: int = programmes.linear.shape[1]
    agent, plane, step = np.nonzero(planes)
    normals, offsets = programmes.normals[agent, plane], programmes.place_offset[agent, step]
    flat = programmes.place_map[agent, step][:, :, None] * normals[:, None]
    rooms = programmes.rooms[agent, plane] - (normals * offsets).sum(axis=1)
    disc_agent, disc, disc_step = np.nonzero(discs)
    move_agent, move = np.nonzero(moves)
    # Second-order cones are (radius, offset - matrix @ z).
    matrix = np.concatenate(
        (programmes.place_map[disc_agent, disc_step], programmes.move_map[move])
    )
    from_centre = (
        programmes.place_offset[disc_agent, disc_step] - programmes.centres[disc_agent, disc]
    )
    offset = np.concatenate((from_centre, programmes.move_offset[move_agent, move]))
    radius = np.concatenate(
        (programmes.radii[disc_agent, disc], programmes.longest[move_agent, move])
    )
    round_rows = np.zeros((len(matrix), 3, size, 2))
    round_rows[:, 1, :, 0] = round_rows[:, 2, :, 1] = -matrix
    rows = np.concatenate((flat, round_rows.reshape(-1, size, 2))).reshape(-1, 2 * size)
    of_row = np.concatenate((agent, np.repeat(np.concatenate((disc_agent, move_agent)), 3)))
    sides = np.concatenate((rooms, np.column_stack((radius, offset)).ravel()))
    hessian = np.einsum("ivw,xy->ivxwy", programmes.hessian, np.eye(2)).reshape(-1, 2 * size)
    upper = hessian * np.tile(np.triu(np.ones((2 * size, 2 * size))), (count, 1))

    def sparse(dense: Floats, owner: Indices) -> Any:
        """Return a sparse matrix: row i of `dense`, in the columns of agent ``owner[i]``."""
        row, column = np.nonzero(dense)
        at = row, owner[row] * 2 * size + column
        return csc_array(coo_array((dense[row, column], at), (len(dense), count * 2 * size)))

    solver: Any = clarabel
    settings = solver.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    cones: list[Any] = [solver.NonnegativeConeT(len(rooms))]
    cones += [solver.SecondOrderConeT(3)] * len(matrix)
    solution: Any = solver.DefaultSolver(
        sparse(upper, np.repeat(np.arange(count), 2 * size)), programmes.linear.ravel(),
        sparse(rows, of_row), sides, cones, settings,
    ).solve()  # fmt: skip
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        return None
    return np.asarray(solution.x, dtype=np.float64).reshape(count, size, 2)


@dataclass(frozen=True, eq=False)
class Inertia:
    """Initial state and limits that a double integrator adds to a programme."""

    velocities_m: Floats  # (n, 2) velocity of each agent in metres per step
    change_m: float  # Largest change of velocity in a step
    # (n,) number of braking steps from the largest speed possible after the next step
    stop_steps: Indices


def stage_weights(share: Floats, horizon: int) -> tuple[Floats, Floats]:
    """Return weights of positions (n, N) and of moves (n,) that reproduce the control law."""
    # Shapes: share (n,).
    places = np.ones((len(share), horizon))
    places[:, -1] = 1.0 / share
    return places, (1.0 - share) / share**2


def solve_programme(
    starts_m: Floats,
    aims_m: Floats,
    share: Floats,  # (n,) as for :func:`stage_weights`
    horizon: int,
    most_m: float,
    sets: SafeSets,
    inertia: Inertia | None = None,
    drifts_m: Floats | None = None,  # (n, 2)
    masses: Floats | None = None,  # (n, N)
) -> tuple[Floats, Floats] | None:
    """Return the optimal paths and velocities of agents, or None if the solver fails."""
    # The objective is ``sum_j w_j m_j |p_j - c_j|^2 + r |p_{j+1} - p_j|^2`` for each agent with
    # aims c, masses m relative to the last one, and the weights of `stage_weights`. With inertia,
    # velocities v add ``|v_{j+1} - v_j|^2 / (2 share)^2``, and half of the last position's weight
    # applies to the stopping position instead.
    # Shapes: starts_m (n, 2); aims_m (n, N, 2), or (n, 2) for aims that move by the drifts only.
    count, changes = len(starts_m), np.eye(horizon) - np.eye(horizon, k=-1)
    wanted = aims_m if aims_m.ndim == 3 else aims_m[:, None]
    length = np.linalg.norm(wanted - starts_m[:, None], axis=2).max(axis=1)
    unit = np.maximum(length, most_m) if np.isfinite(most_m) else length
    unit = np.maximum(unit, LEAST_UNIT * unit.max(initial=0.0))
    unit[unit == 0.0] = 1.0
    drifts = np.zeros((count, 1, 2)) if drifts_m is None else (drifts_m / unit[:, None])[:, None]
    aims = (wanted - starts_m[:, None]) / unit[:, None, None]
    aims = aims + np.arange(1.0, horizon + 1.0)[:, None] * drifts
    weights, effort = stage_weights(share, horizon)
    weights = weights if masses is None else weights * masses
    none = np.zeros((count, horizon, 2))
    most = np.repeat((1.0 - WITHIN) * most_m / unit[:, None], horizon, axis=1)
    if inertia is None:
        # The variables are positions.
        place, shift = np.eye(horizon), none
        reserve = np.repeat(place[None], count, axis=0)
        squares = [(place, weights, aims), (changes, effort[:, None], drifts)]
        kept = horizon if np.isfinite(most_m) else 0
        bounded, less, most = changes[:kept], none[:, :kept], most[:, :kept]
    else:
        # The variables are velocities; a move is the mean of the velocities at its ends.
        place = np.cumsum(np.eye(horizon) - 0.5 * changes, axis=0)
        now = none.copy()
        now[:, 0] = inertia.velocities_m / unit[:, None]
        shift = np.repeat(0.5 * now[:, :1], horizon, axis=1)
        reserve = place + 0.5 * inertia.stop_steps[:, None, None] * np.eye(horizon)
        last = np.zeros((count, horizon))
        last[:, -1] = 0.5 / share
        # The last row is the stopping position relative to the moving aim.
        stop = 0.5 * inertia.stop_steps[:, None, None]
        squares = [
            (place, weights - last, aims - shift),
            (reserve, last, aims - shift + stop * drifts),
            (np.eye(horizon) - 0.5 * changes, effort[:, None], drifts - 0.5 * now),
            (changes, 0.25 / share[:, None] ** 2, now),
        ]
        # Bounded reserves suffice: a position lies between the last one and the stops of both.
        bounded = np.concatenate((np.eye(horizon), changes))
        less = np.concatenate((none, now), axis=1)
        jolt = (1.0 - WITHIN) * inertia.change_m / unit[:, None]
        most = np.concatenate((most, np.repeat(jolt, horizon, axis=1)), axis=1)
    hessian, linear = np.zeros((count, horizon, horizon)), none.copy()
    for matrix, weight, goal in squares:
        # weight * |matrix @ z - goal|^2
        weighted = 2.0 * np.swapaxes(matrix * weight[:, :, None], 1, 2)
        hessian += weighted @ matrix
        linear -= weighted @ np.broadcast_to(goal, none.shape)
    normals, rooms, centres, radii = _tables(sets, starts_m, unit)
    programmes = Programmes(
        hessian, linear, reserve, shift, normals, rooms, centres, radii, bounded, -less, most
    )
    found = solve_programmes(programmes)
    if found is None:
        return None
    places = (place @ found + shift) * unit[:, None, None]
    paths = np.concatenate((starts_m[:, None], starts_m[:, None] + places), axis=1)
    if inertia is None:
        return paths, np.diff(paths, axis=1, prepend=paths[:, :1])
    rates = np.concatenate((inertia.velocities_m[:, None], found * unit[:, None, None]), axis=1)
    return paths, rates


def _tables(
    sets: SafeSets, starts_m: Floats, unit: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the sets' half-planes and discs relative to the starts, scaled by `unit`."""
    count = len(starts_m)
    room = sets.offsets_m - (sets.normals * starts_m[sets.agent]).sum(axis=1)
    normals, rooms = _filled(
        sets.agent, sets.normals, np.maximum(room, 0.0) / unit[sets.agent], count, 1.0
    )
    disc = sets.disc_agent
    centres = (sets.centres_m - starts_m[disc]) / unit[disc][:, None]
    radii = np.maximum(sets.radii_m / unit[disc], np.linalg.norm(centres, axis=1))
    return normals, rooms, *_filled(disc, centres, radii, count, NO_LIMIT)


def _filled(
    agent: Indices, vectors: Floats, values: Floats, count: int, filler: float
) -> tuple[Floats, Floats]:
    """Return `vectors` and `values`, sorted by agent, as padded tables with a row per agent."""
    order = np.argsort(agent, kind="stable")
    number = np.bincount(agent, minlength=count)
    column = np.arange(len(agent)) - np.repeat(np.cumsum(number) - number, number)
    at = agent[order], column
    most = int(number.max(initial=0))
    table, limits = np.zeros((count, most, 2)), np.full((count, most), filler)
    table[at], limits[at] = vectors[order], values[order]
    return table, limits
