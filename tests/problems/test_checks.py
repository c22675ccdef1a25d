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


CART = {"name": "cart", "radius_m": 1.0, "start_m": [5.0, 8.0], "velocity_m_s": [1.0, 0.0]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start_m": [5.0, 6.9]}, r"robots\[0\].start_m: .* 0.9 m from where .* cart is at time 0"),
        ({"velocity_m_s": None}, r"world.moving\[0\]: needs either start_m and velocity_m_s, or"),
        ({"times_s": [0.0], "positions_m": [[1.0, 1.0]]}, r"world.moving\[0\]: needs either"),
        ({"radius_m": 0.0}, r"world.moving\[0\].radius_m"),
        ({"probability": 1.0}, r"world.moving\[0\].probability"),
        ({"position_std_m": -1.0}, r"world.moving\[0\].position_std_m"),
        ({"name": "a b"}, r"world.moving\[0\].name"),
        ({"speed": 1.0}, r"world.moving\[0\].speed"),
    ],
)
def test_moving_obstacles_are_validated(
    tables: Tables, built: Build, changes: dict[str, Any], message: str
) -> None:
    """With the key, and what to do."""
    cart = {key: value for key, value in (CART | changes).items() if value is not None}
    tables["world"]["moving"] = [cart]
    with pytest.raises(InputError, match=message):
        built(tables)


@pytest.mark.parametrize(
    ("times", "places", "message"),
    [
        ([0.0, 2.0], [[1.0, 1.0]], "has 2 times_s and 1 positions_m"),
        ([2.0, 2.0], [[1.0, 1.0], [2.0, 2.0]], "has times_s that do not increase"),
        ([], [], "times_s"),
    ],
)
def test_times_and_places_go_together(
    tables: Tables, built: Build, times: list[float], places: list[Any], message: str
) -> None:
    """As many of both, in order, at least one."""
    cart = {"name": "cart", "radius_m": 1.0, "times_s": times, "positions_m": places}
    tables["world"]["moving"] = [cart]
    with pytest.raises(InputError, match=message):
        built(tables)


def test_moving_obstacles_have_names_of_their_own(tables: Tables, built: Build) -> None:
    """Messages must say which."""
    tables["world"]["moving"] = [CART, CART]
    with pytest.raises(InputError, match=r"moving\[1\].name is .* as that of world.moving\[0\]"):
        built(tables)


def test_robots_must_start_apart(tables: Tables, built: Build) -> None:
    """Exactly the separation is enough."""
    second = {"name": "second", "start_m": [8.0, 5.0], "speed_max_m_s": 1.0}
    tables["problem"]["task"] = "learn"
    tables["objective"] = {"terms": [{"kind": "path_loss_learning"}]}
    del tables["robots"][0]["goal_m"]
    tables["robots"].append(second)
    tables["constraints"]["separation_m"] = 3.0
    assert built(tables).constraints.separation_m == 3.0
    second["start_m"] = [7.9, 5.0]
    with pytest.raises(InputError, match=r"2.9 m from the start of robot, less than") as e:
        built(tables)
    assert e.value.key == "robots[1].start_m"
