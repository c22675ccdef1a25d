"""A free strip whose power is known at every metre, with a station above its middle."""

from pathlib import Path
from typing import Any

import numpy as np

from planopt import Problem
from planopt.problems.problem import problem_from_tables

STATION = {"height_m": 3.0, "transmit_power_dbm": 0.0, "threshold_dbm": -80.0}


def strip(
    folder: Path, gain_db: np.ndarray, robot: dict[str, Any], width_m: float = 20.0, **tables: Any
) -> Problem:
    """A strip of 60 m with a power at every metre, (60,) along x alone or (width, 60)."""
    x, y = np.arange(0.5, 60.0), np.arange(0.5, width_m)
    rows = np.broadcast_to(gain_db, (len(y), len(x)))
    np.savez(folder / "strip.npz", path_gain_db=rows, x=x, y=y)
    truth = {"kind": "raster", "file": "strip.npz", "floor_db": -130.0}
    common = {
        "problem": {"schema": 1, "name": "strip", "task": "reach"},
        "world": {"bounds_m": [0.0, 0.0, 60.0, width_m]},
        "channel": {"truth": truth, "measurements": {"count": 60}},
        "robots": [robot],
        "stations": [{**STATION, "position_m": [30.0, width_m / 2.0]}],
        "constraints": {"p_min": 0.8, "clearance_m": 0.5, "goal_radius_m": 1.0},
        "planner": {"horizon": 5, "step_s": 1.0},
    }
    return problem_from_tables({**common, **tables}, folder=folder, file=None)
