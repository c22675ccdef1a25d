"""The colour rule: a heat map of interpolated powers, cells below a threshold forbidden, then A*.

This is common practice of robotics teams: measure on a drive, interpolate, colour the map, and keep
to the green cells. If they do not join start and goal, the threshold is lowered until they do.

``python examples/planners/colour_rule.py simulate open_field --planner colour_rule``
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from grid import GridPlanner
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from planopt.cli import main
from planopt.extend import PlannerKind, register_planner

LEVELS_DB = (0.0, -3.0, -6.0, -9.0, -12.0, -np.inf)
"""Margins above the connection threshold that colour a cell green, in the order of trial."""


class ColourRulePlanner(GridPlanner):
    """A* on the cells whose interpolated power is above a threshold."""

    def route(self, context: Any) -> Any:
        """Return the shortest route over green cells."""
        here, margin_db = context.position_m, self.heat_map_db(context)
        for level_db in LEVELS_DB:
            costs = np.where(margin_db >= level_db, 1.0, np.inf)
            # Start and goal are connected to the map whatever their colour.
            for place in (here, self.goal_m):
                near = np.linalg.norm(self.nodes_m - place, axis=1) <= 1.5 * self.spacing_m
                costs[near] = 1.0
            corners = self.searched(here, costs)
            if corners:
                return self.shortened(np.array(corners), costs)
        return here[None]

    def heat_map_db(self, context: Any) -> Any:
        """Return the interpolated power above the threshold of the best station, by node."""
        margins = []
        for posterior, station in zip(context.posteriors, self.problem.stations, strict=True):
            measured = posterior.measurements
            places, power = measured.positions_m, measured.power_dbm - station.threshold_dbm
            inside = LinearNDInterpolator(places, power)(self.nodes_m)
            beyond = NearestNDInterpolator(places, power)(self.nodes_m)
            margins.append(np.where(np.isnan(inside), beyond, inside))
        return np.max(margins, axis=0)


if __name__ == "__main__":
    register_planner(PlannerKind("colour_rule", ColourRulePlanner, reaches_goals=True))
    sys.exit(main())
