"""Lattice nodes in passages that are narrower than the lattice resolves.

The nodes of a regular lattice miss a passage between obstacles if its free space, in which the
robot keeps the clearance, is narrower than the spacing. A disc that does not fit into the passage
finds it (morphological opening). Nodes whose cells the passage crosses are moved into it.
"""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.arrays import Floats, Indices
from planopt.world.clearance import ObstacleIndex, clearance_m, is_clear, segment_lines
from planopt.world.workspace import Workspace

DISC_RADIUS = 0.5
"""Radius of the disc, in lattice spacings. A strip as wide as the spacing contains nodes."""

DISC_SLACK = 1.01
"""Growth of the opened space, so that polygonal arcs leave no slivers."""

CROSSED = 0.3
"""Least diagonal of the part of a passage in a cell for which its node is moved, in spacings."""

SAME_M = 1e-6
"""Distance within which two positions are the same, in metres."""

TOUCHING = 0.05
"""Distance from the obstacles' clearance, in disc radii, up to which a boundary belongs to it."""


def nodes_in_passages(
    workspace: Workspace,
    index: ObstacleIndex,
    positions_m: Floats,  # (ny, nx, 2) of the regular nodes
    anchor_m: Floats,  # (2,) position of a node that stays
    spacing_m: float,
    required_m: float,
) -> tuple[Indices, Floats]:
    """Return the nodes (k, 2) in narrow passages as (iy, ix) and their new positions (k, 2)."""
    passages = narrow_passages(workspace, index, DISC_RADIUS * spacing_m, required_m)
    if not len(passages):
        return np.zeros((0, 2), np.intp), np.zeros((0, 2))
    ny, nx = positions_m.shape[:2]
    bounds = (_corners(passages) - positions_m[0, 0]) / spacing_m
    first, last = np.clip(np.rint(bounds).astype(np.intp), 0, (nx - 1, ny - 1)).swapaxes(0, 1)
    around = [
        low[::-1] + np.argwhere(np.ones((high - low + 1)[::-1], np.bool_))
        for low, high in zip(first, last, strict=True)
    ]
    nodes: Indices = np.concatenate(around)
    numbers: Indices = np.repeat(np.arange(len(passages)), [len(each) for each in around])
    centres, half = positions_m[nodes[:, 0], nodes[:, 1]], 0.5 * spacing_m
    (left, low), (right, high) = (centres - half).T, (centres + half).T
    cells = np.asarray(shapely.box(left, low, right, high), np.object_)
    crossings = shapely.intersection(cells, passages[numbers])
    parts, whole = shapely.get_parts(crossings, return_index=True)
    crossed = _corners(parts)
    kept = np.linalg.norm(crossed[:, 1] - crossed[:, 0], axis=1) > CROSSED * spacing_m
    kept &= np.linalg.norm(centres[whole] - anchor_m, axis=1) > half
    parts, nodes = parts[kept], nodes[whole[kept]]
    area: Floats = shapely.area(parts)  # pyright: ignore[reportUnknownMemberType]
    order = np.argsort(-area, kind="stable")
    parts, nodes = parts[order], nodes[order]
    places = _centred(index, parts, 2.0 * half)
    clear = is_clear(clearance_m(index, places), required_m)
    nodes, places = nodes[clear], places[clear]
    _, largest = np.unique(nodes[:, 0] * nx + nodes[:, 1], return_index=True)
    return nodes[largest], places[largest]


def _corners(shapes: NDArray[np.object_]) -> Floats:
    """Return the lower and upper corners (k, 2, 2) of the bounding boxes of shapes."""
    bounds: Floats = shapely.bounds(shapes)  # pyright: ignore[reportUnknownMemberType]
    return bounds.reshape(-1, 2, 2)


def _centred(index: ObstacleIndex, parts: NDArray[np.object_], longest_m: float) -> Floats:
    """Return a position (k, 2) in each part, midway between the sides of the passage."""
    inside = shapely.centroid(parts)
    places = shapely.get_coordinates(inside)
    near = index.polygons[index.tree.query_nearest(inside, all_matches=False)[1]]
    gaps: NDArray[np.object_] = shapely.shortest_line(near, inside)  # pyright: ignore
    feet = shapely.get_coordinates(gaps)[::2]
    across = places - feet
    across *= longest_m / np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
    lines = shapely.intersection(segment_lines(places - across, places + across), parts)
    chords, part = shapely.get_parts(lines, return_index=True)
    own = shapely.dwithin(chords, inside[part], SAME_M)
    part, middles = part[own], shapely.get_coordinates(shapely.centroid(chords[own]))
    # At the mouth, the line to the nearest obstacle does not cross the passage at right angles.
    wider = clearance_m(index, middles) > clearance_m(index, places[part])
    places[part[wider]] = middles[wider]
    return places


def narrow_passages(
    workspace: Workspace, index: ObstacleIndex, radius_m: float, required_m: float
) -> NDArray[np.object_]:
    """Return the parts of the free space that connect wider parts, but hold no disc."""
    covered = shapely.union_all(shapely.buffer(index.polygons, required_m))
    box = shapely.box(*workspace.bounds_m)
    free = box.difference(covered)
    wide = free.buffer(-radius_m, quad_segs=4).buffer(DISC_SLACK * radius_m, quad_segs=4)
    narrow = shapely.get_parts(free.difference(wide))
    narrow = narrow[np.ptp(_corners(narrow), axis=1).max(axis=1, initial=0.0) > SAME_M]
    rings: NDArray[np.object_] = shapely.get_exterior_ring(narrow)  # pyright: ignore
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    middles = 0.5 * (corners[:-1] + corners[1:])[ring[:-1] == ring[1:]]
    ring = ring[:-1][ring[:-1] == ring[1:]]
    low, high = np.array(workspace.bounds_m[:2]), np.array(workspace.bounds_m[2:])
    away = np.minimum(
        clearance_m(index, middles) - required_m,
        np.minimum(middles - low, high - middles).min(axis=1, initial=np.inf),
    )
    opens = away > TOUCHING * radius_m
    first = np.searchsorted(ring, ring)
    before = np.arange(len(ring)) - 1
    before[before < first] = np.searchsorted(ring, ring[before < first], side="right") - 1
    mouths = np.bincount(ring[opens & ~opens[before]], minlength=len(narrow))
    return narrow[mouths > 1]
