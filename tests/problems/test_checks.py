"""Checks over several keys: places, bounds, truth and threshold."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from planopt.errors import InputError
from planopt.problems.checks import MAX_TRUTH_CELLS
from planopt.problems.problem import Problem

Tables = dict[str, Any]
Build = Callable[[object], Problem]


@pytest.mark.parametrize("key", ["start_m", "goal_m"])
@pytest.mark.parametrize(
    ("place", "message"),
    [
        ([25, 15], r"is \[25.0, 15.0\], inside the obstacle hall"),
        ([20, 15], "inside the obstacle hall"),
        ([19.5, 15], "0.5 m from the obstacle hall, less than the clearance of 1 m"),
        ([7, 29.1], "0.9 m from the obstacle obstacle 1"),
        ([-1, 5], r"outside the bounds \[0.0, 0.0, 50.0, 40.0\]"),
        ([5, 40.001], "outside the bounds"),
    ],
)
def test_place_must_be_free(
    tables: Tables, built: Build, key: str, place: list[float], message: str
) -> None:
    """A start or goal inside, on or too near an obstacle, or out of bounds, names what is wrong."""
    tables["robots"][0][key] = place
    with pytest.raises(InputError, match=message) as caught:
        built(tables)
    assert caught.value.key == f"robots[0].{key}"
    assert caught.value.file == "small.toml"


@pytest.mark.parametrize("place", [[19, 15], [0, 0], [50, 40]])
def test_place_at_the_limit_is_free(tables: Tables, built: Build, place: list[float]) -> None:
    """Exactly the clearance is enough, and the bounds belong to the workspace."""
    tables["robots"][0]["start_m"] = place
    assert built(tables).robots[0].start_m == tuple(place)


def test_courtyard_is_free(tables: Tables, built: Build) -> None:
    """A hole of an obstacle is free, with the clearance from the walls around it."""
    tables["world"]["obstacles"][0]["holes"] = [[[22, 12], [28, 12], [28, 18], [22, 18]]]
    tables["robots"][0]["start_m"] = [25, 15]
    built(tables)
    tables["robots"][0]["start_m"] = [22.5, 15]
    with pytest.raises(InputError, match=r"0\.5 m from the obstacle hall"):
        built(tables)


def test_world_without_obstacles_is_free(tables: Tables, built: Build) -> None:
    """No obstacle, no clearance to keep."""
    del tables["world"]["obstacles"]
    assert built(tables).workspace.obstacles == ()


@pytest.mark.parametrize("bounds", [[50, 0, 0, 40], [0, 40, 50, 0], [0, 0, 0, 40]])
def test_bounds_must_have_area(tables: Tables, built: Build, bounds: list[float]) -> None:
    """Reversed or empty bounds are an error of the bounds, not of what is outside them."""
    tables["world"]["bounds_m"] = bounds
    with pytest.raises(InputError, match="x_min < x_max") as caught:
        built(tables)
    assert caught.value.key == "world.bounds_m"


def test_measurements_need_a_truth_to_be_taken_from(tables: Tables, built: Build) -> None:
    """Without a truth only a log can give measurements."""
    del tables["channel"]["truth"]
    with pytest.raises(InputError, match="not given") as caught:
        built(tables)
    assert caught.value.key == "channel.measurements.count"
    tables["channel"]["measurements"] = {"file": "log.csv"}
    assert built(tables).channel.truth is None


def test_truth_must_fit_into_memory(tables: Tables, built: Build) -> None:
    """The number of cells is counted before any is made."""
    tables["channel"]["truth"]["cell_m"] = (50 * 40 / MAX_TRUTH_CELLS) ** 0.5 * 0.99
    with pytest.raises(InputError, match=r"more than 4e\+06") as caught:
        built(tables)
    assert caught.value.key == "channel.truth.cell_m"
    tables["channel"]["truth"]["cell_m"] = 5e-324
    with pytest.raises(InputError, match="cells"):
        built(tables)


def test_threshold_must_be_above_the_floor(tables: Tables, built: Build) -> None:
    """At the floor every place would count as connected: 20 dBm - 75 dB = -55 dBm."""
    tables["channel"]["truth"]["floor_db"] = -75.0
    with pytest.raises(InputError, match="floor of -55 dBm") as caught:
        built(tables)
    assert caught.value.key == "stations[0].threshold_dbm"
    tables["channel"]["truth"]["floor_db"] = -75.1
    built(tables)
