"""A small valid problem as tables, which tests change one key at a time."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from planopt import Problem
from planopt.problems.problem import problem_from_tables


@pytest.fixture
def tables() -> dict[str, Any]:
    """Fresh tables: two obstacles, one robot, one station, a drawn channel."""
    return {
        "problem": {"schema": 1, "name": "small"},
        "world": {
            "bounds_m": [0.0, 0.0, 50.0, 40.0],
            "obstacles": [
                {"name": "hall", "polygon": [[20, 10], [30, 10], [30, 20], [20, 20]]},
                {"wkt": "POLYGON ((5 30, 9 30, 7 34, 5 30))"},
            ],
        },
        "channel": {
            "truth": {
                "kind": "model",
                "k_pl_db": -30.0,
                "n_pl": 2.4,
                "shadow_std_db": 4.0,
                "decorrelation_m": 15.0,
                "multipath_std_db": 1.5,
                "cell_m": 1.0,
            },
            "measurements": {"count": 50},
            "fit": {"method": "capped"},
        },
        "robots": [{"start_m": [5.0, 5.0], "goal_m": [45.0, 15.0], "speed_max_m_s": 1.0}],
        "stations": [
            {"position_m": [25.0, 5.0], "transmit_power_dbm": 20.0, "threshold_dbm": -55.0}
        ],
        "constraints": {"p_min": 0.8},
        "planner": {"step_s": 1.0},
    }


@pytest.fixture
def built() -> Callable[[object], Problem]:
    """Makes the problem of given tables, as from a file ``small.toml`` in the working folder."""

    def build(data: object) -> Problem:
        return problem_from_tables(data, folder=Path.cwd(), file=Path("small.toml"))

    return build
