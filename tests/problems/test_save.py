"""A problem as plain data and back."""

import json
from pathlib import Path

import pytest
from refusals import refused
from small_tables import (
    CART,
    CASADI,
    HEAVY,
    LEARN,
    MAPPING,
    MODEL,
    OWN,
    RASTER,
    REACH,
    TIMED,
    TRACK,
    WHEELS,
    Build,
    Tables,
    of_terms,
    set_keys,
)

from planopt import Problem, load
from planopt.channel import LogFormat, Nakagami
from planopt.problems import LoggedMeasurements, problem_from_dict, problem_to_dict

RAYLEIGH = {"kind": "rayleigh"}
J_CH = {"variance_threshold_db2": 2.0, "closeness_per_m": 0.1}


def there_and_back(problem: Problem) -> Problem:
    return problem_from_dict(json.loads(json.dumps(problem_to_dict(problem))), file=problem.file)


@pytest.mark.parametrize("name", ["munich_courier", "outdoor_track", "connect_rooftop"])
def test_a_saved_problem_file_is_the_same_problem(name: str, tmp_path: Path) -> None:
    """``Problem.save`` writes a file that loads to an equal problem."""
    problem, file = load(name), tmp_path / "mine.toml"
    problem.save(file)
    assert load(file) == problem
    with refused():
        problem.save(tmp_path / "mine.json")


def test_every_setting_survives(tables: Tables, built: Build, tmp_path: Path) -> None:
    """Settings that differ from every default, a hole, an odd coordinate and a log come back."""
    tables["problem"]["description"] = "odd – ünïcode"
    tables["world"]["obstacles"][0] |= {
        "name": "",
        "holes": [[[22.1 + 1e-13, 12], [28, 12], [25, 18]], [[22, 18.5], [23, 18.5], [22, 19]]],
    }
    tables["channel"]["truth"]["floor_db"] = -99.5
    tables["channel"]["measurements"] = {
        "file": str(tmp_path / "log.csv"),
        "columns": {"x": "east", "power": "rssi"},
        "censored_column": "near_floor",
        "floor_dbm": -101.5,
        "spacing_m": 3.25,
    }
    tables["robots"][0]["name"] = "r2"
    tables["stations"][0] |= {"name": "s2", "height_m": 12.5}
    tables["objective"] = {"effort_weight_s2_m2": 0.7, "cost_to_go": "geodesic"}
    tables["constraints"] |= {"clearance_m": 0.25, "goal_radius_m": 2.5}
    tables["planner"] |= {"name": "lattice", "horizon": 7, "neighbours": 33, "max_steps": 77}
    tables["report"] = {"figures": False}
    problem = built(tables)
    assert problem.channel.measurements == LoggedMeasurements(
        tmp_path / "log.csv", LogFormat(("east", None, "rssi"), "near_floor", -101.5)
    )
    assert there_and_back(problem) == problem


def test_problem_in_full_names_no_obstacle_file() -> None:
    """Obstacles are in the data, so that a saved plan can be checked from its own files."""
    data = problem_to_dict(load("munich_courier"))
    assert len(data["world"]["obstacles"]) == 742
    assert all({"name", "polygon"} <= table.keys() for table in data["world"]["obstacles"])
    assert Path(data["channel"]["truth"]["file"]).is_absolute()


def test_restored_data_is_validated_and_names_its_file(tables: Tables, built: Build) -> None:
    """A saved problem that was edited gives the same errors as a problem file."""
    data = problem_to_dict(built(tables))
    data["robots"][0]["start_m"] = [25.0, 15.0]
    with refused() as caught:
        problem_from_dict(data, file=Path("plan.json"))
    assert caught.value.file == "plan.json"
    with refused() as caught:
        problem_from_dict(data)
    assert caught.value.file is None


SURVIVE = [
    (LEARN, {}),
    (LEARN, HEAVY | {"robots.0.start_velocity_m_s": [0.25, -0.5]}),
    (LEARN, WHEELS | {"robots.0.start_heading_rad": 2.5, "robots.0.speed_min_m_s": -0.25}),
    (LEARN, {"robots.0.weights": [2.0], "robots.0.start_spread_m": 1.5}),
    (TRACK, {"targets.0.packets": "estimates", "targets.0.start_distance_m": 3.0}),
    (of_terms("connect", {"kind": "until_connected", "weight": 0.5, "beyond_m": 80.0}), {}),
    (of_terms("custom", OWN | {"weight": -2.0}), CASADI),
    *((of_terms("map", MAPPING | {"form": form, **J_CH}), {}) for form in ("path", "two_layer")),
    *(
        (REACH, {"channel.truth": RASTER | fading})
        for fading in (
            {"multipath": {"kind": "rayleigh"}},
            {"multipath": {"kind": "rician", "m": 3.27}},
            {"multipath": {"kind": "nakagami", "std_db": 2.6}},
            {"multipath": {"kind": "lognormal", "k": 10.0}},
            {"rician_k": 10.0},
            {},
        )
    ),
    (REACH, {"channel.truth": MODEL | {"multipath": {"kind": "nakagami", "m": 3.27}}}),
    *(
        (REACH, {"world.moving": [TIMED | {"position_std_m": 0.1, "probability": 0.95} | motion]})
        for motion in (
            {"start_m": [15.0, 8.0], "velocity_m_s": [1.0, -0.5]},
            {"start_m": [15.0, 8.0], "velocity_m_s": [0.0, 0.0]},
            {"times_s": [1.0, 2.5], "positions_m": [[15.0, 8.0], [0.1, 0.2]]},
            {"times_s": [3.0], "positions_m": [[15.0, 8.0]], "velocity_m_s": [0.5, 0.25]},
        )
    ),
    (REACH, {"world.moving": [CART]}),
]


@pytest.mark.parametrize(("base", "changes"), SURVIVE)
def test_tables_survive_json_exactly(
    tables: Tables, built: Build, base: Tables, changes: Tables
) -> None:
    """Whatever a value was given by, the problem comes back."""
    set_keys(tables, base)
    set_keys(tables, changes)
    problem = built(tables)
    assert there_and_back(problem) == problem


def test_laws_of_multipath_in_files(tables: Tables, built: Build) -> None:
    """A Rician factor keeps its key; another law stands in place of the deviation that it gives."""
    for fading, has_factor in (({"rician_k": 10.0}, True), ({"multipath": RAYLEIGH}, False)):
        tables["channel"]["truth"] = RASTER | fading
        saved = problem_to_dict(built(tables))["channel"]["truth"]
        assert ("rician_k" in saved) == has_factor
    tables["channel"]["truth"] = MODEL | {"multipath": {"kind": "nakagami", "m": 3.27}}
    truth = built(tables).channel.truth
    assert truth.multipath == Nakagami(3.27) and abs(truth.multipath_std_db - 2.60) < 0.01
