"""Coverage by shortest distances, round obstacles: cells, cost, gradient and where to move.

The region is represented by the nodes of :class:`planopt.coverage.geodesic.GeodesicRegion`. For
them everything is exact: ``H = sum of mass * d(p_i, q)^2 + spread`` with d the shortest distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planopt.coverage.geodesic import GeodesicRegion, nearest_place
from planopt.errors import InputError

HALVINGS = 8
"""How often a step is halved until it lowers the cost of the agent's own cell."""

AT_CORNER = 1e-9
"""A corner nearer than this share of the region's extent is where the agent stands."""


@dataclass(frozen=True, eq=False)
class GeodesicCells:
    """The agent nearest to each node by the shortest path."""

    # (m,) number of the nearest agent; the smallest number of agents at one place
    owner: NDArray[np.intp]
    distance_m: NDArray[np.float64]  # (m,) length of the shortest path to it
    # (m, 2) unit vector in which that path leaves the agent; 0 where they coincide
    direction: NDArray[np.float64]
    cost: float  # The coverage cost H
    mass: NDArray[np.float64]  # (n,) mass of each agent's cell
    gradient: NDArray[np.float64]  # (n, 2) derivative of H by each agent's place


@dataclass(frozen=True, eq=False)
class _Corners:
    """Shortest ways from agents to the region's corners."""

    length_m: NDArray[np.float64]  # (n, c) lengths; infinite if the agent sees no corner
    first: NDArray[np.intp]  # (n, c) the corner that the way passes first


def geodesic_cells(region: GeodesicRegion, agents_m: NDArray[np.float64]) -> GeodesicCells:
    """Divide the nodes of a region among agents, and evaluate the coverage cost."""
    # Shapes: agents_m (n, 2).
    agents = _checked(region, agents_m)
    corners = _to_corners(region, agents)
    nodes, count = region.nodes_m, len(agents)
    distance = np.full(len(nodes), np.inf)
    owner = np.zeros(len(nodes), dtype=np.intp)
    turn = np.full(len(nodes), -1, dtype=np.intp)
    if len(region.corners_m):
        # Beyond a corner only the agent that is nearest to it matters.
        best = corners.length_m.argmin(axis=0)
        reach = corners.length_m[best, np.arange(len(best))]
        through = reach + np.linalg.norm(nodes[:, None] - region.corners_m, axis=2)
        through[~region.corner_sees] = np.inf
        turn = through.argmin(axis=1)
        distance = through[np.arange(len(nodes)), turn]
        owner = best[turn]
    # Straight lines, to the nearest agents first, as long as they may be shorter.
    tree, waiting = KDTree(agents), np.arange(len(nodes))
    near, fetched = np.zeros((len(nodes), 0), dtype=np.intp), 0
    for rank in range(count):
        if rank >= fetched:
            fetched = min(count, max(4, 2 * fetched))
            near = np.zeros((len(nodes), fetched), dtype=np.intp)
            near[waiting] = _nearest(tree, nodes[waiting], fetched)
        agent = near[waiting, rank]
        straight = np.linalg.norm(nodes[waiting] - agents[agent], axis=1)
        # Straight also where a way over the corner that the agent stands on is as long.
        kept = straight <= distance[waiting] * (1.0 + AT_CORNER)
        waiting, agent, straight = waiting[kept], agent[kept], straight[kept]
        if not len(waiting):
            break
        seen = region.sees(agents[agent], nodes[waiting])
        found = waiting[seen]
        owner[found], distance[found], turn[found] = agent[seen], straight[seen], -1
        waiting = waiting[~seen]
    toward = nodes - agents[owner]
    bent = turn >= 0
    toward[bent] = region.corners_m[corners.first[owner[bent], turn[bent]]] - agents[owner[bent]]
    length = np.linalg.norm(toward, axis=1)
    direction = toward / np.where(length > 0.0, length, 1.0)[:, None]
    pull = 2.0 * region.mass * distance
    gradient = np.zeros((count, 2))
    for axis in range(2):
        gradient[:, axis] -= np.bincount(owner, pull * direction[:, axis], minlength=count)
    cost = float(region.mass @ distance**2) + region.spread
    mass = np.asarray(np.bincount(owner, region.mass, minlength=count), dtype=np.float64)
    return GeodesicCells(owner, distance, direction, cost, mass, gradient)


def geodesic_targets(
    region: GeodesicRegion, agents_m: NDArray[np.float64], cells: GeodesicCells
) -> NDArray[np.float64]:
    """Return where each agent should move: toward the middle of its cell, by a free straight line.

    The step is the mean over the cell of distance times leaving direction, which is ``C - p`` where
    nothing is in the way. It ends before an obstacle, or slides to the nearest free place, and is
    halved until it lowers the agent's own share of H. Moving all agents to their targets therefore
    never raises H.
    """
    count = len(agents_m)
    mass = np.where(cells.mass > 0.0, cells.mass, 1.0)
    step = -0.5 * cells.gradient / mass[:, None]
    before = np.bincount(cells.owner, region.mass * cells.distance_m**2, minlength=count)
    targets, waiting = agents_m.copy(), np.flatnonzero((step != 0.0).any(axis=1))
    for halving in range(HALVINGS):
        tried = agents_m.copy()
        tried[waiting] = _reached(region, agents_m[waiting], step[waiting] * 0.5**halving)
        share = _own_cost(region, tried, cells.owner, waiting)
        better = waiting[share[waiting] < before[waiting]]
        targets[better] = tried[better]
        waiting = np.setdiff1d(waiting, better)
        if not len(waiting):
            break
    return targets


def geodesic_distances_m(
    region: GeodesicRegion, agents_m: NDArray[np.float64], places_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the shortest distances of agents to places."""
    # Shapes: agents_m, places_m (n, 2).
    agents = _checked(region, agents_m)
    found = np.where(
        region.sees_each(agents, places_m),
        np.linalg.norm(agents[:, None] - places_m, axis=2),
        np.inf,
    )
    if len(region.corners_m):
        reach = _to_corners(region, agents).length_m
        last = np.linalg.norm(region.corners_m[:, None] - places_m, axis=2)
        last[~region.sees_each(region.corners_m, places_m)] = np.inf
        for length, to_place in zip(reach.T, last, strict=True):
            found = np.minimum(found, length[:, None] + to_place)
    return found


def geodesic_paths(
    region: GeodesicRegion, agents_m: NDArray[np.float64], places_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the length of the shortest path of each agent to a place of its own, and where to."""
    # Shapes: agents_m, places_m (n, 2); returns (n,).
    agents = _checked(region, agents_m)
    length, first = np.linalg.norm(places_m - agents, axis=1), places_m.copy()
    blind = np.flatnonzero(~region.sees(agents, places_m))
    if len(blind) and len(region.corners_m):
        corners = _to_corners(region, agents[blind])
        last = np.linalg.norm(places_m[blind][:, None] - region.corners_m, axis=2)
        last[~region.sees_each(places_m[blind], region.corners_m)] = np.inf
        through = corners.length_m + last
        best, own = through.argmin(axis=1), np.arange(len(blind))
        length[blind] = through[own, best]
        first[blind] = region.corners_m[corners.first[own, best]]
    return length, first


def _checked(region: GeodesicRegion, agents_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Agents as an array (n, 2) of free places."""
    agents = np.asarray(agents_m, dtype=np.float64)
    if agents.ndim != 2 or agents.shape[1] != 2 or not len(agents):
        raise InputError(f"places of shape {agents.shape} are given", key="agents")
    wrong = np.ones(len(agents), dtype=np.bool_)
    finite = np.asarray(np.isfinite(agents).all(axis=1))
    wrong[finite] = ~region.contains(agents[finite])
    if wrong.any():
        which = int(wrong.argmax())
        x, y = agents[which]
        raise InputError(f"({x:g}, {y:g}) is not in the free area", key=f"agents[{which}]")
    return agents


def _nearest(tree: KDTree, places: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Numbers (k, count) of the agents nearest to places (k, 2), nearest first."""
    found = tree.query(places, k=count)[1]  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    return np.asarray(found, dtype=np.intp).reshape(len(places), count)  # pyright: ignore[reportUnknownArgumentType]


def _to_corners(region: GeodesicRegion, agents: NDArray[np.float64]) -> _Corners:
    """Shortest ways from agents (n, 2) to all corners."""
    corners, count = region.corners_m, len(agents)
    if not len(corners):
        return _Corners(np.zeros((count, 0)), np.zeros((count, 0), dtype=np.intp))
    away = np.linalg.norm(agents[:, None] - corners, axis=2)
    away[~region.sees_each(agents, corners)] = np.inf
    length, first = np.empty(away.shape), np.empty(away.shape, dtype=np.intp)
    extent = float(np.ptp(region.nodes_m, axis=0).max())
    for agent in range(count):
        through = away[agent, :, None] + region.between_m
        length[agent] = through.min(axis=0)
        # A way that begins with the corner the agent stands on leaves toward the next one.
        at = away[agent] <= AT_CORNER * extent
        if at.any() and not at.all():
            through[at] += AT_CORNER * extent
        first[agent] = through.argmin(axis=0)
    return _Corners(length, first)


def _own_cost(
    region: GeodesicRegion,
    agents: NDArray[np.float64],
    owner: NDArray[np.intp],
    wanted: NDArray[np.intp],
) -> NDArray[np.float64]:
    """Return the cost of each cell from its agent's place; (n,), 0 for agents not wanted."""
    asked = np.zeros(len(agents), dtype=np.bool_)
    asked[wanted] = True
    nodes = np.flatnonzero(asked[owner])
    own = owner[nodes]
    distance = np.linalg.norm(region.nodes_m[nodes] - agents[own], axis=1)
    blind = ~region.sees(agents[own], region.nodes_m[nodes])
    if blind.any():
        ways = _to_corners(region, agents[wanted]).length_m
        row = np.zeros(len(agents), dtype=np.intp)
        row[wanted] = np.arange(len(wanted))
        hidden = nodes[blind]
        through = ways[row[own[blind]]] + np.linalg.norm(
            region.nodes_m[hidden][:, None] - region.corners_m, axis=2
        )
        through[~region.corner_sees[hidden]] = np.inf
        distance[blind] = through.min(axis=1)
    return np.asarray(
        np.bincount(own, region.mass[nodes] * distance**2, minlength=len(agents)), dtype=np.float64
    )


def _reached(
    region: GeodesicRegion, starts: NDArray[np.float64], steps: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return where steps (k, 2) from places (k, 2) lead within what is allowed to agents.

    That is the end of the step if it is in sight, else the nearest allowed place to it if that is
    in sight, else the last allowed place on the line.
    """
    ends = starts + steps
    fine = region.allows(starts, ends)
    for which in np.flatnonzero(~fine):
        start, end = starts[which], ends[which]
        nearest = nearest_place(region.allowed, end)
        if region.allows(start[None], nearest[None])[0]:
            ends[which] = nearest
            continue
        line = shapely.LineString([start, end])
        touching = shapely.get_parts(line.intersection(region.allowed))
        touching = touching[shapely.dwithin(touching, shapely.Point(start), 0.0)]
        places = np.concatenate((start[None], shapely.get_coordinates(touching)))
        ends[which] = places[int(np.linalg.norm(places - start, axis=1).argmax())]
    return ends
