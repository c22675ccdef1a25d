"""Exact distances to obstacles, used by the verifier."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.arrays import Floats, Mask
from planopt.world.workspace import Obstacle, Workspace


@dataclass(frozen=True)
class ObstacleIndex:
    """Obstacles with a spatial index."""

    obstacles: tuple[Obstacle, ...]  # Obstacles of the workspace
    polygons: NDArray[np.object_]  # (k,) polygons, for vectorised calls
    tree: shapely.STRtree  # Spatial index with indices into `obstacles`


def index_obstacles(workspace: Workspace) -> ObstacleIndex:
    """Return the obstacles of a workspace with a spatial index."""
    polygons = np.array([obstacle.polygon for obstacle in workspace.obstacles], dtype=np.object_)
    return ObstacleIndex(workspace.obstacles, polygons, shapely.STRtree(polygons))


def polygons_of(area: shapely.Geometry) -> list[shapely.Polygon]:
    """Return the polygons of an area."""
    parts = shapely.get_parts(area).tolist()
    return [part for part in parts if isinstance(part, shapely.Polygon) and part.area > 0.0]


def segment_lines(starts_m: Floats, ends_m: Floats) -> NDArray[np.object_]:
    """Return the segments between the rows of two ``(n, 2)`` arrays as ``(n,)`` geometries."""
    # A segment whose squared length underflows becomes a point; GEOS would divide by zero.
    delta = ends_m - starts_m
    lines = np.asarray(shapely.linestrings(np.stack((starts_m, ends_m), axis=1)), np.object_)
    still = (delta * delta).sum(axis=1) == 0.0
    if still.any():
        lines[still] = shapely.points(starts_m[still])
    return lines


def distances_m(shapes: NDArray[np.object_], polygons: NDArray[np.object_]) -> Floats:
    """Return the distances (n,) between two arrays of geometries, 0 for geometries that touch."""
    # Shapely declares no types for the keyword arguments of this function.
    return shapely.distance(shapes, polygons)  # pyright: ignore[reportUnknownMemberType]


def is_clear(distance_m: Floats, required_m: float, tolerance_m: float = 0.0) -> Mask:
    """Return a mask of obstacle distances (n,) that satisfy the required clearance."""
    # A distance of 0 means contact or intersection: a collision even if `required_m` is 0.
    return (distance_m > 0.0) & (distance_m >= required_m - tolerance_m)


def clearance_m(index: ObstacleIndex, positions_m: Floats) -> Floats:
    """Return the distance (n,) of each position (n, 2) to the nearest obstacle."""
    finite = np.asarray(np.isfinite(positions_m).all(axis=1))
    points = np.asarray(shapely.points(positions_m[finite]), np.object_)
    return _spread(_nearest_m(index, points), finite)


def swept_clearance_m(index: ObstacleIndex, path_m: Floats) -> Floats:
    """Return the exact distances (n - 1,) of the segments of a path to the nearest obstacle."""
    return segment_clearance_m(index, path_m[:-1], path_m[1:])


def segment_clearance_m(index: ObstacleIndex, starts_m: Floats, ends_m: Floats) -> Floats:
    """Return the exact distance (n,) of each segment to its nearest obstacle."""
    finite = np.asarray(np.isfinite(starts_m + ends_m).all(axis=1))
    return _spread(_nearest_m(index, segment_lines(starts_m[finite], ends_m[finite])), finite)


def segments_clear(
    index: ObstacleIndex, starts_m: Floats, ends_m: Floats, required_m: float
) -> Mask:
    """Return a mask of the segments that keep the clearance; no distances are computed."""
    # The result equals `is_clear` of `segment_clearance_m`.
    clear = np.asarray(np.isfinite(starts_m + ends_m).all(axis=1))
    rows = np.flatnonzero(clear)
    if index.obstacles and rows.size:
        # Obstacles at exactly the required distance are allowed, unless it is 0.
        near_m = max(float(np.nextafter(required_m, -np.inf)), 0.0)
        lines = segment_lines(starts_m[rows], ends_m[rows])
        hits = index.tree.query(lines, predicate="dwithin", distance=near_m)
        clear[rows[hits[0]]] = False
    return clear


def inside_bounds(workspace: Workspace, positions_m: Floats) -> Mask:
    """Return a mask of the positions (n, 2) inside the workspace bounds or on their boundary."""
    x_min, y_min, x_max, y_max = workspace.bounds_m
    x, y = positions_m[:, 0], positions_m[:, 1]
    return (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)


def containing_obstacle(index: ObstacleIndex, position_m: Floats) -> Obstacle | None:
    """Return the first obstacle that contains or touches a position (2,), or None."""
    x, y = position_m
    hits = index.tree.query(shapely.Point(x, y), predicate="intersects")
    return index.obstacles[int(hits.min())] if hits.size else None


def _nearest_m(index: ObstacleIndex, shapes: NDArray[np.object_]) -> Floats:
    """Return the distance (n,) of each of n geometries from its nearest obstacle."""
    nearest = np.full(shapes.shape, np.inf)
    if index.obstacles and shapes.size:
        (which, _), distance = index.tree.query_nearest(
            shapes, return_distance=True, all_matches=False
        )
        nearest[which] = distance
    return nearest


def _spread(values: Floats, where: Mask) -> Floats:
    """Return an array (n,) with `values` at the true entries of `where`, and NaN elsewhere."""
    spread = np.full(where.shape, np.nan)
    spread[where] = values
    return spread
