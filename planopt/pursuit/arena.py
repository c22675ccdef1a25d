"""Where a pursuit takes place: open space, a rectangle, or among obstacles with shortest paths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.pursuit.service import require_number
from planopt.world.clearance import ObstacleIndex, clearance_m, index_obstacles, segment_lines
from planopt.world.shortest_ways import (
    ROUND_SHARE,
    ShortestWays,
    shortest_ways,
    turns_m,
    way_lengths_m,
)
from planopt.world.workspace import Workspace


@dataclass(frozen=True)
class Arena:
    """Free space of a pursuit.

    Attributes
    ----------
    bounds_m
        ``(x_min, y_min, x_max, y_max)``; None for open space.
    obstacles
        What nobody may enter; None for nothing.
    clearance_m
        How far everybody stays away from obstacles.

    Raises
    ------
    InputError
        There are obstacles without bounds or without a positive clearance.
    """

    bounds_m: tuple[float, float, float, float] | None = None
    obstacles: ObstacleIndex | None = None
    clearance_m: float = 0.0

    def __post_init__(self) -> None:
        if self.obstacles is not None and self.bounds_m is None:
            raise InputError("an arena with obstacles needs bounds", key="bounds_m")
        if self.obstacles is not None:
            require_number(self.clearance_m, "clearance_m", above=0.0)

    def moved(
        self, place_m: NDArray[np.float64], moves_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return where moves (k, 2) from a place (2,) lead: no farther than bounds.

        A move that would come too near an obstacle is not made at all.
        """
        ends_m = self.within(place_m + moves_m)
        if self.obstacles is not None:
            lines = segment_lines(np.broadcast_to(place_m, ends_m.shape), ends_m)
            blocked = np.zeros(len(ends_m), dtype=np.bool_)
            hit = self.obstacles.tree.query(
                lines, predicate="dwithin", distance=0.999 * self.clearance_m
            )[0]
            blocked[hit] = True
            ends_m = np.where(blocked[:, None], place_m, ends_m)
        return ends_m

    def within(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the nearest places (..., 2) within the bounds."""
        if self.bounds_m is None:
            return places_m
        return np.clip(places_m, self.bounds_m[:2], self.bounds_m[2:])

    def route_m(
        self, place_m: NDArray[np.float64], goal_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the corners of the shortest path from a place to a goal, the goal last; (k, 2).

        A goal that nobody may stand at is replaced by the nearest place that is free.
        """
        if self.obstacles is None:
            return goal_m[None]
        goal_m = self.free_m(goal_m)
        turns = turns_m(self._ways(place_m), goal_m)
        if turns is None:
            raise InputError(
                f"no path leads from {_words(place_m)} to {_words(goal_m)}",
                remedy="let the pursuer and the evader start in the same part of free space",
            )
        return turns

    def distances_m(
        self, place_m: NDArray[np.float64], goals_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the length of the shortest path to each goal (k, 2), as ``(k,)``."""
        if self.obstacles is None:
            return np.linalg.norm(goals_m - place_m, axis=1)
        return way_lengths_m(self._ways(place_m), goals_m)

    def free_m(self, place_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the nearest place that shortest paths lead to."""
        place_m = self.within(place_m)
        if self.obstacles is None or self.bounds_m is None or self._is_free(place_m):
            return place_m
        grown = shapely.union_all(shapely.buffer(self.obstacles.polygons, 1.01 * self._margin_m))
        free = shapely.box(*self.bounds_m).difference(grown)
        # Shapely types the keyword arguments of this one as unknown.
        nearest = shapely.shortest_line(  # pyright: ignore[reportUnknownMemberType]
            shapely.Point(*place_m), free
        )
        return np.asarray(shapely.get_coordinates(nearest)[-1], dtype=np.float64)

    @property
    def _margin_m(self) -> float:
        """Paths round corners on polygons, which are a little farther from them than asked."""
        return ROUND_SHARE * self.clearance_m

    def _is_free(self, place_m: NDArray[np.float64]) -> bool:
        assert self.obstacles is not None
        return float(clearance_m(self.obstacles, place_m[None])[0]) > self._margin_m

    def _ways(self, place_m: NDArray[np.float64]) -> ShortestWays:
        """Shortest paths from a place, also from one in the margin."""
        assert self.obstacles is not None and self.bounds_m is not None
        width_m, height_m = np.subtract(self.bounds_m[2:], self.bounds_m[:2]).tolist()
        # No shortest path is longer than all walls of a maze this size could make it.
        radius_m = 4.0 * (width_m + height_m)
        return shortest_ways(
            self.obstacles, self.bounds_m, place_m, self.clearance_m, radius_m, inner=False
        )


def arena_of(workspace: Workspace, clearance_m: float) -> Arena:
    """Return the arena of a workspace, whose moving obstacles are left out."""
    obstacles = index_obstacles(workspace) if workspace.obstacles else None
    return Arena(workspace.bounds_m, obstacles, clearance_m)


def _words(place_m: NDArray[np.float64]) -> str:
    return f"({place_m[0]:.6g}, {place_m[1]:.6g})"
