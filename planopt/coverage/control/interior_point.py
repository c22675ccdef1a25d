"""A primal-dual interior-point method for many small programmes of one shape at once.

Agents do not share variables, so that every agent has its own step lengths and leaves the batch as
soon as it is solved. Each iteration factors one small dense matrix for each agent.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

MOST_ITERATIONS = 60
"""Agents that are not solved by then are left to another solver."""

TOLERANCE = 1e-9
"""Largest product of a constraint's slack and multiplier, in units of the cost's largest weight."""

RESIDUAL = 1e-8
"""Largest violation of a constraint and of the gradient of the Lagrangian, in the same units."""

BOUNDARY = 0.995
"""Share of the way to the nearest bound that an iteration takes."""

FIRST = 0.1
"""Least slack of a constraint, and its product with the multiplier, before the first iteration."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Programmes:
    """Convex programmes of n agents with V variables in two dimensions each, z of shape (V, 2).

    Minimise ``1/2 z' hessian z + linear' z``, the same Hessian for both dimensions. Places
    ``place_map @ z + place_offset`` stay in half-planes and discs, and ways ``way_map @ z +
    way_offset`` are at most so long.
    """

    hessian: Floats  # (n, V, V), positive definite, and (n, V, 2)
    linear: Floats
    place_map: Floats  # (n, N, V) and (n, N, 2)
    place_offset: Floats
    # (n, K, 2) and (n, K): normal @ place <= room. Zero normals with positive room fill the table
    # up.
    normals: Floats
    rooms: Floats
    centres: Floats  # (n, D, 2) and (n, D); infinite radii fill up
    radii: Floats
    way_map: Floats  # (R, V), (n, R, 2) and (n, R)
    way_offset: Floats
    longest: Floats

    def of(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Programmes:
        """Return the programmes of some agents."""
        every = {each.name: getattr(self, each.name) for each in fields(self)}
        return Programmes(**{k: v if k == "way_map" else v[chosen] for k, v in every.items()})


@dataclass(frozen=True, eq=False)
class _Linear:
    """Constraints ``c(z) <= 0`` about a point: values (n, M) and what their gradients need.

    The order is half-planes, discs, ways.
    """

    given: Programmes
    values: Floats
    to_centre: Floats
    ways: Floats

    def along(self, move: Floats) -> Floats:
        """Directional derivatives (n, M) along a move (n, V, 2)."""
        p = self.given
        places, ways = p.place_map @ move, p.way_map @ move
        planes = p.normals @ places.transpose(0, 2, 1)
        discs = (self.to_centre * places[:, None]).sum(axis=3)
        return _flat(planes, discs, (self.ways * ways).sum(axis=2))

    def pulled(self, weights: Floats) -> Floats:
        """The sum (n, V, 2) of gradients with weights (n, M)."""
        p = self.given
        planes, discs, ways = self._split(weights)
        at_places = planes.transpose(0, 2, 1) @ p.normals
        at_places += (discs[..., None] * self.to_centre).sum(axis=1)
        return p.place_map.transpose(0, 2, 1) @ at_places + p.way_map.T @ (
            ways[..., None] * self.ways
        )

    def curvature(self, weights: Floats, multipliers: Floats) -> Floats:
        """Sum (n, 2 V, 2 V) of gradients' squares with weights and Hessians with multipliers.

        Variables of the first dimension come first.
        """
        p, size = self.given, self.given.hessian.shape[1]
        planes, discs, ways = self._split(weights)
        _, disc_multipliers, way_multipliers = self._split(multipliers)
        at_places = planes.transpose(0, 2, 1) @ _products(p.normals)
        at_places += (discs[..., None] * _products(self.to_centre)).sum(axis=1)
        at_ways = ways[..., None] * _products(self.ways)
        round_places = (disc_multipliers / p.radii[..., None]).sum(axis=1)
        round_ways = way_multipliers / p.longest
        pairs = (p.way_map[:, :, None] * p.way_map[:, None]).reshape(len(p.way_map), -1)
        found = np.empty((len(weights), 2, size, 2, size))
        for entry, (one, other) in enumerate(((0, 0), (0, 1), (1, 1))):
            place, way = at_places[..., entry], at_ways[..., entry]
            if one == other:
                place, way = place + round_places, way + round_ways
            block = p.place_map.transpose(0, 2, 1) @ (place[..., None] * p.place_map)
            block += (way @ pairs).reshape(block.shape)
            found[:, one, :, other] = found[:, other, :, one] = block
        return found.reshape(len(weights), 2 * size, 2 * size)

    def _split(self, values: Floats) -> tuple[Floats, Floats, Floats]:
        """Values (n, M) of half-planes (n, K, N), discs (n, D, N) and ways (n, R)."""
        count, steps = self.given.place_offset.shape[:2]
        planes, discs = self.given.rooms.shape[1] * steps, self.given.radii.shape[1] * steps
        return (
            values[:, :planes].reshape(count, -1, steps),
            values[:, planes : planes + discs].reshape(count, -1, steps),
            values[:, planes + discs :],
        )


def solve_programmes(given: Programmes) -> tuple[Floats, NDArray[np.bool_]]:
    """Return optima ``(n, V, 2)`` of programmes, and for whom they were found ``(n,)``."""
    scale = np.abs(given.hessian).max(axis=(1, 2))[:, None, None]
    every = {each.name: getattr(given, each.name) for each in fields(given)}
    given = Programmes(**every | {"hessian": given.hessian / scale, "linear": given.linear / scale})
    best = np.asarray(np.linalg.solve(given.hessian, -given.linear), dtype=np.float64)
    solved = np.asarray((_linear(given, best).values <= 0.0).all(axis=1), dtype=np.bool_)
    left = np.flatnonzero(~solved)
    if not len(left):
        return best, solved
    # An agent that gets nowhere ends with numbers that are not finite; another solver has it then.
    with np.errstate(all="ignore"):
        _iterate(given, left, best, solved)
    return best, solved


def _iterate(
    given: Programmes, left: NDArray[np.intp], best: Floats, solved: NDArray[np.bool_]
) -> None:
    """Put optima of the programmes that are left in their places, and note them as solved."""
    p, z = given.of(left), np.zeros_like(best[left])
    at = _linear(p, z)
    slack = np.maximum(-at.values, FIRST)
    dual = FIRST / slack
    for _ in range(MOST_ITERATIONS):
        gap = p.hessian @ z + p.linear + at.pulled(dual)
        miss = at.values + slack
        mean = (slack * dual).mean(axis=1)
        error = np.maximum(np.abs(gap).max(axis=(1, 2)), np.abs(miss).max(axis=1))
        done = ((slack * dual).max(axis=1) <= TOLERANCE) & (error <= RESIDUAL)
        go = ~done & np.isfinite(error)
        if not go.all():
            best[left[done]], solved[left[done]] = z[done], True
            left, p, z, slack, dual = left[go], p.of(go), z[go], slack[go], dual[go]
            gap, miss, mean = gap[go], miss[go], mean[go]
            if not len(left):
                return
            at = _linear(p, z)
        matrix = at.curvature(dual / slack, dual)
        size = p.hessian.shape[1]
        matrix[:, :size, :size] += p.hessian
        matrix[:, size:, size:] += p.hessian
        try:
            factor = np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
        except np.linalg.LinAlgError:
            return
        wanted = slack * dual
        for centred in (False, True):
            right = gap + at.pulled((dual * miss - wanted) / slack)
            move = -_solved(factor, right)
            change = -miss - at.along(move)
            turn = -(wanted + dual * change) / slack
            step = np.minimum(_longest(slack, change), _longest(dual, turn))
            if not centred:
                ahead = ((slack + step[:, None] * change) * (dual + step[:, None] * turn)).mean(
                    axis=1
                )
                centre = (ahead / mean) ** 3 * mean
                wanted = slack * dual + change * turn - centre[:, None]
        z = z + step[:, None, None] * move
        slack, dual = slack + step[:, None] * change, dual + step[:, None] * turn
        at = _linear(p, z)


def _linear(p: Programmes, z: Floats) -> _Linear:
    """The constraints about z (n, V, 2); circles as ``(|v|^2 / r - r) / 2``."""
    places, ways = p.place_map @ z + p.place_offset, p.way_map @ z + p.way_offset
    planes = p.normals @ places.transpose(0, 2, 1) - p.rooms[..., None]
    away = places[:, None] - p.centres[:, :, None]
    radii = p.radii[..., None]
    discs = 0.5 * ((away * away).sum(axis=3) / radii - radii)
    lengths = 0.5 * ((ways * ways).sum(axis=2) / p.longest - p.longest)
    return _Linear(
        p, _flat(planes, discs, lengths), away / radii[..., None], ways / p.longest[..., None]
    )


def _flat(planes: Floats, discs: Floats, ways: Floats) -> Floats:
    """Values of half-planes, discs and ways as (n, M)."""
    count = len(ways)
    return np.concatenate((planes.reshape(count, -1), discs.reshape(count, -1), ways), axis=1)


def _products(vectors: Floats) -> Floats:
    """``x x, x y, y y`` of vectors (..., 2)."""
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack((x * x, x * y, y * y), axis=-1)


def _longest(values: Floats, change: Floats) -> Floats:
    """The longest steps (n,), at most 1, after which values (n, M) are still positive."""
    share = np.where(change < 0.0, -change / values, 0.0).max(axis=1)
    return np.minimum(1.0, BOUNDARY / np.maximum(share, BOUNDARY))


def _solved(factor: Floats, right: Floats) -> Floats:
    """Solutions (n, V, 2) for right sides (n, V, 2) by substitution."""
    count, size = factor.shape[:2]
    x = right.transpose(0, 2, 1).reshape(count, size).copy()
    for row in range(size):
        x[:, row] -= (factor[:, row, :row] * x[:, :row]).sum(axis=1)
        x[:, row] /= factor[:, row, row]
    for row in range(size - 1, -1, -1):
        x[:, row] -= (factor[:, row + 1 :, row] * x[:, row + 1 :]).sum(axis=1)
        x[:, row] /= factor[:, row, row]
    return x.reshape(count, 2, -1).transpose(0, 2, 1)
