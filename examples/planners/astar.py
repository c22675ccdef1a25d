"""A* to the goal: the shortest path on a grid of the free space, without any radio.

``python examples/planners/astar.py simulate open_field --planner astar`` registers the planner and
passes the arguments to planopt.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from grid import GridPlanner

from planopt.cli import main
from planopt.extend import PlannerKind, register_planner


class AStarPlanner(GridPlanner):
    """Every metre of the free space costs the same."""

    def metre_costs(self, context: Any) -> Any:
        """Return the cost per metre at each node (n,)."""
        return np.ones(len(self.nodes_m))


if __name__ == "__main__":
    register_planner(PlannerKind("astar", AStarPlanner, reaches_goals=True))
    sys.exit(main())
