"""Tables of small problems, and changes of them by dotted key."""

from collections.abc import Callable
from copy import deepcopy
from typing import Any

from planopt import Problem

Tables = dict[str, Any]
Build = Callable[[object], Problem]
DROP = object()
"""In place of a value: the key is left out."""

TRACKING = {
    "kind": "tracking",
    "noise_curvature": 0.008,
    "noise_floor_m2": 0.08,
    "sweet_spot_m": 1.0,
}
OWN = {"kind": "casadi", "steps": 5, "program": "1.5"}
CASADI = {"problem.task": "custom", "planner.horizon": 5}
YARD = {"world.obstacles.0.holes": [[[22, 12], [28, 12], [28, 18], [22, 18]]]}
CART = {"name": "cart", "radius_m": 1.0, "start_m": [5.0, 8.0], "velocity_m_s": [1.0, 0.0]}
TIMED = {"name": "cart", "radius_m": 1.0}
TWO = {"start_m": [8.0, 5.0], "speed_max_m_s": 1.0}
RASTER = {"kind": "raster", "file": "a.npz", "floor_db": -130.0}
MODEL = {"kind": "model", "k_pl_db": -30.0, "n_pl": 2.0, "shadow_std_db": 4.0} | {
    "decorrelation_m": 10.0,
    "cell_m": 1.0,
}
RULE = {"p_min": 0.9}
DATA = {"connectivity": "data", "data_mbit": 5.0, "deadline_s": 9.5, "rate_mbit_s": 2.0}
HEAVY = {"robots.0.dynamics": "double_integrator", "robots.0.acceleration_max_m_s2": 0.3}
WHEELS = {"robots.0.dynamics": "unicycle", "robots.0.turn_rate_max_rad_s": 1.0}
LATE = {"planner.max_steps": 6, "planner.step_s": 0.5, "planner.horizon": 4}


def of_terms(task: str, *terms: Tables) -> Tables:
    """The changes that make the small problem one of a sum of terms."""
    return {"problem.task": task, "objective": {"terms": list(terms)}, "robots.0.goal_m": DROP}


REACH: Tables = {}
LEARN = of_terms("learn", {"kind": "path_loss_learning"})
MAPPING = {"kind": "mapping"}
MAP = of_terms("map", MAPPING)
TRACK = of_terms("track", TRACKING) | {
    "targets": [{"start_m": [5.0, 5.0], "velocity_m_s": [0.1, 0.0]}]
}


def set_keys(tables: Tables, changes: Tables) -> None:
    """Give dotted keys other values; a number counts the entries of an array."""
    for path, value in changes.items():
        *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
        table: Any = tables
        for part in parents:
            table = table[part]
        if value is DROP:
            table.pop(last, None)
        elif isinstance(table, list) and last == len(table):
            table.append(deepcopy(value))
        else:
            table[last] = deepcopy(value)
