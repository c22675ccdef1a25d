"""Robots that must keep apart, and carts that cross their ways."""

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from terms_scene import LEARNING, TABLES, TRACKING

from planopt import Problem
from planopt.problems.problem import problem_from_tables

CART = {"name": "cart", "radius_m": 1.0, "start_m": [5.0, 20.0], "velocity_m_s": [1.0, 0.0]}


def apart_problem(
    robots: Sequence[tuple[float, float] | dict[str, Any]],
    moving: tuple[dict[str, Any], ...] = (CART,),
    separation_m: float = 3.0,
    learns: bool = False,
    obstacles: list[dict[str, Any]] | None = None,
    **planner: Any,
) -> Problem:
    """Robots of the small scene that track, or learn, and keep apart."""
    tables = copy.deepcopy(TABLES)
    tables["problem"]["task"] = "learn" if learns else "track"
    tables["objective"] = {"terms": [dict(LEARNING if learns else TRACKING)]}
    if not learns:
        tables["targets"] = [{"start_m": [14.0, 18.0], "velocity_m_s": [0.9, 0.2]}]
    tables["robots"] = [
        {
            "name": f"r{number}",
            "speed_max_m_s": 2.0,
            **(robot if isinstance(robot, dict) else {"start_m": [float(each) for each in robot]}),
        }
        for number, robot in enumerate(robots)
    ]
    tables["constraints"] = {"clearance_m": 0.5, "separation_m": separation_m}
    if obstacles is not None:
        tables["world"]["obstacles"] = obstacles
    tables["world"]["moving"] = [dict(table) for table in moving]
    tables["planner"].update(planner)
    return problem_from_tables(tables, folder=Path(), file=None)
