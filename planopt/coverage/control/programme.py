# pyright: basic
"""The optimal control problem of all agents as one second-order cone programme.

Agents do not share variables, so that the programme is block-diagonal and Clarabel solves a
thousand agents at once. Each agent's block is in units of its own distances, about its own place.
Velocities are in units of length per step.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.control.safe_sets import SafeSets

WITHIN = 1e-6
"""Limits are kept with this relative spare, so that the solver's tolerance does not break them."""

LEAST_UNIT = 1e-3
"""An agent nearer to its aim than this share of the farthest one's distance is scaled by that."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Inertia:
    """What a double integrator adds to a programme.

    Attributes
    ----------
    velocities_m
        ``(n, 2)`` way that each agent would go in a step at its velocity.
    change_m
        Largest change of that in a step.
    stop_steps
        ``(n,)`` in how many steps an agent stops from the largest speed it can have after the next.
    """

    velocities_m: Floats
    change_m: float
    stop_steps: NDArray[np.intp]


def stage_weights(share: Floats, horizon: int) -> tuple[Floats, Floats]:
    """Return the weights of places ``(n, N)`` and of moves ``(n,)`` whose first move is the law's.

    Parameters
    ----------
    share
        ``(n,)`` gain times the step, the share of the distance that the law covers in it.
    horizon
        Number of steps N.
    """
    places = np.ones((len(share), horizon))
    places[:, -1] = 1.0 / share
    return places, (1.0 - share) / share**2


def saturated_paths(
    starts_m: Floats, aims_m: Floats, share: Floats, horizon: int, most_m: float
) -> Floats:
    """Return the optimal paths ``(n, N + 1, 2)`` of agents whose way to the aim is free.

    They lie on the straight line, each move is the law's clipped to the largest move `most_m`.
    """
    paths = np.empty((len(starts_m), horizon + 1, 2))
    paths[:, 0] = starts_m
    for step in range(horizon):
        way = aims_m - paths[:, step]
        length = np.linalg.norm(way, axis=1)
        part = np.minimum(share, most_m / np.where(length > 0.0, length, 1.0))
        paths[:, step + 1] = paths[:, step] + part[:, None] * way
    return paths


def solve_programme(
    starts_m: Floats,
    aims_m: Floats,
    share: Floats,
    horizon: int,
    most_m: float,
    sets: SafeSets,
    inertia: Inertia | None = None,
) -> tuple[Floats, Floats] | None:
    """Return the optimal paths and velocities of agents, or None if the solver gives up.

    It minimises ``sum_j w_j |p_j - c|^2 + r |p_{j+1} - p_j|^2`` for each agent with aim c and the
    weights of :func:`stage_weights`. With inertia, velocities w add
    ``|w_{j+1} - w_j|^2 / (2 share)^2``, and half of the last place's weight is that of the place
    where the agent would stop.

    Parameters
    ----------
    starts_m, aims_m
        ``(n, 2)``.
    share
        ``(n,)`` as for :func:`stage_weights`.
    horizon
        Number of steps.
    most_m
        Longest move of a step; infinite without limit.
    sets
        Where each agent stays in; it holds all starts.
    inertia
        For double integrators; None for single ones.

    Returns
    -------
    tuple of arrays, or None
        Paths ``(n, N + 1, 2)`` and velocities ``(n, N + 1, 2)`` on arrival in metres per step.
    """
    import clarabel

    count = len(starts_m)
    length = np.linalg.norm(aims_m - starts_m, axis=1)
    unit = np.maximum(length, most_m) if np.isfinite(most_m) else length
    unit = np.maximum(unit, LEAST_UNIT * unit.max(initial=0.0))
    unit[unit == 0.0] = 1.0
    aims = ((aims_m - starts_m) / unit[:, None])[:, None]
    weights, effort = stage_weights(share, horizon)
    place, change = np.eye(horizon), np.eye(horizon) - np.eye(horizon, k=-1)
    if inertia is None:
        programme = _Programme(count, horizon)
        programme.add_squares(place, weights, aims)
        programme.add_squares(change, effort[:, None], 0.0)
        programme.stay_in(sets, starts_m, unit, place[None])
        if np.isfinite(most_m):
            programme.shorten(change, most_m / unit, 0.0)
    else:
        programme = _Programme(count, 2 * horizon)
        none = np.zeros((horizon, horizon))
        now = np.zeros((count, horizon, 2))
        now[:, 0] = inertia.velocities_m / unit[:, None]
        stop = 0.5 * inertia.stop_steps[:, None, None]
        place, speed = np.hstack((place, none)), np.hstack((none, place))
        # A move is the mean of the velocities before and after it.
        mean = np.hstack((none, np.eye(horizon) - 0.5 * change))
        change, jolt = np.hstack((change, none)), np.hstack((none, change))
        last = np.zeros((count, horizon))
        last[:, -1] = 0.5 / share
        programme.add_squares(place, weights - last, aims)
        programme.add_squares(place + stop * speed, last, aims)
        programme.add_squares(change, effort[:, None], 0.0)
        programme.add_squares(jolt, 0.25 / share[:, None] ** 2, now)
        # Places follow: each is between the one before, where that stops, and where it stops.
        programme.stay_in(sets, starts_m, unit, place + stop * speed)
        programme.shorten(speed, most_m / unit, 0.0)
        programme.shorten(jolt, inertia.change_m / unit, now)
        programme.equate(change - mean, 0.5 * now)
    settings = clarabel.DefaultSettings()  # pyright: ignore[reportAttributeAccessIssue]
    settings.verbose = False
    settings.max_threads = 1
    solver = clarabel.DefaultSolver(*programme.posed(), settings)  # pyright: ignore[reportAttributeAccessIssue]
    solution: Any = solver.solve()
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        return None
    found = np.asarray(solution.x, dtype=np.float64).reshape(count, -1, horizon, 2)
    found *= unit[:, None, None, None]
    paths = np.concatenate((starts_m[:, None], starts_m[:, None] + found[:, 0]), axis=1)
    if inertia is None:
        return paths, np.diff(paths, axis=1, prepend=paths[:, :1])
    return paths, np.concatenate((inertia.velocities_m[:, None], found[:, 1]), axis=1)


@dataclass(eq=False)
class _Programme:
    """A block-diagonal programme over variables z, `width` places for each of `count` agents.

    Matrices take one agent's variables, ``(r, width)``, or ``(n, r, width)`` if agents differ.
    """

    count: int
    width: int
    hessian: Floats = field(init=False)
    linear: Floats = field(init=False)
    entries: list[tuple[NDArray[np.intp], NDArray[np.intp], Floats]] = field(default_factory=list)
    right: list[Floats] = field(default_factory=list)
    cones: list[Any] = field(default_factory=list)
    rows: int = 0

    def __post_init__(self) -> None:
        self.hessian = np.zeros((self.count, self.width, self.width))
        self.linear = np.zeros((self.count, self.width, 2))

    def add_squares(self, matrix: Floats, weights: Floats, aims: Floats | float) -> None:
        """Add ``weights (n, r) * |matrix @ z - aims (n, r, 2)|^2`` to the cost."""
        weighted = 2.0 * np.swapaxes(matrix * weights[:, :, None], 1, 2)
        self.hessian += weighted @ matrix
        size = (self.count, matrix.shape[-2], 2)
        self.linear -= weighted @ np.broadcast_to(np.asarray(aims, dtype=np.float64), size)

    def stay_in(self, sets: SafeSets, starts_m: Floats, unit: Floats, matrix: Floats) -> None:
        """Keep ``start + unit * matrix @ z`` within the set of each agent."""
        import clarabel

        own, steps = sets.agent, matrix.shape[1]
        room = sets.offsets_m - (sets.normals * starts_m[own]).sum(axis=1)
        self._add(own, matrix, sets.normals[:, None])
        self.right.append(np.repeat(np.maximum(room, 0.0) / unit[own], steps))
        self.cones.append(clarabel.NonnegativeConeT(len(own) * steps))  # pyright: ignore[reportAttributeAccessIssue]
        disc = sets.disc_agent
        away = (starts_m[disc] - sets.centres_m) / unit[disc][:, None]
        radius = np.maximum(sets.radii_m / unit[disc], np.linalg.norm(away, axis=1))
        self._balls(disc, matrix, radius, np.repeat(-away[:, None], steps, axis=1))

    def shorten(self, matrix: Floats, most: Floats, less: Floats | float) -> None:
        """Keep each ``matrix @ z - less (n, r, 2)`` at most as long as `most` (n,)."""
        size = (self.count, matrix.shape[-2], 2)
        less = np.broadcast_to(np.asarray(less, dtype=np.float64), size)
        self._balls(np.arange(self.count), matrix[None], (1.0 - WITHIN) * most, less)

    def equate(self, matrix: Floats, right: Floats) -> None:
        """Require ``matrix @ z = right (n, r, 2)``."""
        import clarabel

        self._add(np.arange(self.count), matrix[None], np.eye(2))
        self.right.append(right.ravel())
        self.cones.append(clarabel.ZeroConeT(right.size))  # pyright: ignore[reportAttributeAccessIssue]

    def posed(self) -> tuple[object, Floats, object, Floats, list[Any]]:
        """Hessian, linear cost, constraints, right sides and cones as Clarabel takes them."""
        from scipy.sparse import coo_array, csc_array

        agent, row, column = np.nonzero(np.triu(self.hessian))
        value = self.hessian[agent, row, column]
        base, axes = 2 * self.width * agent[:, None], np.arange(2)
        total = 2 * self.width * self.count
        at = (base + 2 * row[:, None] + axes).ravel(), (base + 2 * column[:, None] + axes).ravel()
        hessian = coo_array((np.repeat(value, 2), at), shape=(total, total))
        rows, columns, values = (np.concatenate(one) for one in zip(*self.entries, strict=True))
        matrix = coo_array((values, (rows, columns)), shape=(self.rows, total))
        right = np.concatenate(self.right)
        return csc_array(hessian), self.linear.ravel(), csc_array(matrix), right, self.cones

    def _balls(self, agent: NDArray[np.intp], matrix: Floats, radius: Floats, less: Floats) -> None:
        """Keep ``matrix @ z - less (k, r, 2)`` of agents (k,) within radii (k,)."""
        import clarabel

        self._add(agent, matrix, np.array([[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]]))
        wide = np.broadcast_to(radius[:, None, None], (*less.shape[:2], 1))
        self.right.append(np.concatenate((wide, -less), axis=2).ravel())
        size = less.shape[0] * less.shape[1]
        self.cones.extend([clarabel.SecondOrderConeT(3)] * size)  # pyright: ignore[reportAttributeAccessIssue]

    def _add(self, agent: NDArray[np.intp], matrix: Floats, axes: Floats) -> None:
        """Add rows: for agents (k,) and steps r, the rows of `axes` (s, 2), or (k, s, 2), each."""
        whole = np.broadcast_to(matrix, (self.count, *matrix.shape[1:]))[agent]
        which, step, column = np.nonzero(whole)
        axes = np.broadcast_to(axes, (len(agent), *axes.shape[-2:]))
        size, steps = axes.shape[1], whole.shape[1]
        row = self.rows + size * (steps * which + step)[:, None, None]
        row = row + np.arange(size)[:, None] + np.zeros(2, dtype=np.intp)
        at = 2 * (self.width * agent[which] + column)[:, None, None] + np.arange(2)
        value = whole[which, step, column][:, None, None] * axes[which]
        at = np.broadcast_to(at, row.shape)
        self.entries.append((row.ravel(), at.ravel(), value.ravel()))
        self.rows += size * steps * len(agent)
