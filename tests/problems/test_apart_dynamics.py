"""Who may be asked to keep apart."""

import pytest
from terms_scene import TABLES, TRACKING

from planopt.errors import InputError
from planopt.problems.load import problem_from_tables

CART = {
    "start_m": [10.0, 15.0],
    "speed_max_m_s": 2.0,
    "dynamics": "unicycle",
    "turn_rate_max_rad_s": 1.0,
}
TRAM = {"name": "tram", "start_m": [30.0, 30.0], "velocity_m_s": [0.1, 0.0], "radius_m": 1.0}


@pytest.mark.parametrize(
    ("world", "constraints", "key"),
    [
        ({"moving": [TRAM]}, {}, "world.moving"),
        ({}, {"separation_m": 2.0}, "constraints.separation_m"),
    ],
)
def test_curved_ways_are_refused(tmp_path, world, constraints, key):
    """A robot that drives curves is not asked to keep from what moves; the error says who it is."""
    tables = {
        **TABLES,
        "problem": {**TABLES["problem"], "task": "track"},
        "objective": {"terms": [TRACKING]},
        "targets": [{"start_m": [14.0, 18.0], "velocity_m_s": [0.9, 0.2]}],
        "robots": [CART],
        "world": {**TABLES["world"], **world},
        "constraints": {**TABLES["constraints"], **constraints},
    }
    with pytest.raises(InputError, match=r"robots\[0\] \(robot\) does not") as caught:
        problem_from_tables(tables, folder=tmp_path, file=None)
    assert caught.value.key == key
