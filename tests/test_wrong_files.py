"""Wrong problem files of every kind: one line of ours, exit code 2, nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest

from planopt.cli import main

REACH = """
[problem]
schema = 1
name = "wrong"
[world]
bounds_m = [0.0, 0.0, 50.0, 40.0]
[channel.truth]
kind = "model"
k_pl_db = -30.0
n_pl = 2.4
shadow_std_db = 4.0
decorrelation_m = 15.0
multipath_std_db = 1.5
cell_m = 1.0
[channel.measurements]
count = 50
[[robots]]
name = "a"
start_m = [5.0, 5.0]
goal_m = [45.0, 15.0]
speed_max_m_s = 1.0
[[stations]]
position_m = [25.0, 5.0]
transmit_power_dbm = 20.0
threshold_dbm = -55.0
[constraints]
p_min = 0.8
[planner]
step_s = 1.0
horizon = 3
"""

TRACK = (
    REACH.replace('name = "wrong"', 'name = "wrong"\ntask = "track"').replace(
        "goal_m = [45.0, 15.0]\n", ""
    )
    + """
[[targets]]
start_m = [20.0, 20.0]
velocity_m_s = [0.5, 0.0]
[[objective.terms]]
kind = "tracking"
noise_curvature = 0.01
noise_floor_m2 = 0.1
sweet_spot_m = 1.0
"""
)

# What stands there, what is written in its place, and what the message must name.
REPLACED = [
    ("[0.0, 0.0, 50.0, 40.0]", "[nan, 0.0, 50.0, 40.0]", "world.bounds_m[0]: is nan"),
    ("[0.0, 0.0, 50.0, 40.0]", "[0.0, 0.0, inf, 40.0]", "world.bounds_m[2]: is inf"),
    ("[0.0, 0.0, 50.0, 40.0]", "[50.0, 0.0, 0.0, 40.0]", "x_min < x_max"),
    ("[0.0, 0.0, 50.0, 40.0]", "[0.0, 0.0, 0.0, 0.0]", "x_min < x_max"),
    ("[0.0, 0.0, 50.0, 40.0]", "[0.0, 0.0, 50.0]", "should have more numbers"),
    ("[0.0, 0.0, 50.0, 40.0]", "[0.0, 0.0, 50.0, 40.0, 1.0]", "world.bounds_m"),
    ("[0.0, 0.0, 50.0, 40.0]", "[0.0, 0.0, 9e6, 9e6]", "channel.truth.cell_m"),
    ("[0.0, 0.0, 50.0, 40.0]", '"wide"', "should be an array"),
    ("cell_m = 1.0", "cell_m = 1e-9", "channel.truth.cell_m"),
    ('kind = "model"', 'kind = "modle"', "should be one of 'raster', 'model'"),
    ("n_pl = 2.4", "n_pl = 0.0", "channel.truth.n_pl"),
    ("cell_m = 1.0", "cell_m = 1.0\nfloor_db = -60.0", "receiver's floor"),
    ("count = 50", "count = 0", "channel.measurements.count"),
    ("count = 50", "count = 1979-05-27", "should be a whole number"),
    ("count = 50", 'count = 50\nfile = "log.csv"', "exactly one of count and file"),
    ("count = 50", 'file = "."', "is not a file"),
    ("speed_max_m_s = 1.0", "speed_max_m_s = true", "should be a number"),
    ("speed_max_m_s = 1.0", "speed_max_m_s = -1.0", "robots[0].speed_max_m_s"),
    ("speed_max_m_s = 1.0", "speed_max_m_s = 1e-300", "makes steps of 1e-300 m"),
    ("speed_max_m_s = 1.0", "speed_max_m_s = 0.002", "planner.step_s"),
    ("speed_max_m_s = 1.0", "max_speed_m_s = 1.0", "did you mean speed_max_m_s?"),
    ("start_m = [5.0, 5.0]", "start_m = [-5.0, 5.0]", "outside the bounds"),
    ("start_m = [5.0, 5.0]", "start_m = [nan, 5.0]", "robots[0].start_m[0]"),
    ("goal_m = [45.0, 15.0]", "goal_m = [55.0, 15.0]", "outside the bounds"),
    ("goal_m = [45.0, 15.0]\n", "", "needs robots[0].goal_m"),
    ("[[robots]]", "[robots]", "should be an array"),
    ("position_m = [25.0, 5.0]", "position_m = [1e12, 5.0]", "stations[0].position_m[0]"),
    ("threshold_dbm = -55.0", "threshold_dbm = -inf", "stations[0].threshold_dbm"),
    ("[constraints]", "[constraint]", "did you mean constraints?"),
    ("p_min = 0.8", "pmin = 0.8", "did you mean p_min?"),
    ("p_min = 0.8", "p_min = 1.0", "constraints.p_min"),
    ("p_min = 0.8", "p_min = 0.0", "needs constraints.p_min above 0"),
    ("p_min = 0.8", "p_min = 0.8\np_min = 0.9", "is not TOML"),
    ("p_min = 0.8", 'p_min = 0.8\nconnectivity = "outage"', "outage_max_s"),
    (
        "p_min = 0.8",
        'p_min = 0.8\nconnectivity = "stated_times"\nconnected_times_s = [1e6]',
        "a run ends after 400 s",
    ),
    ("step_s = 1.0", "step_s = 0.0", "planner.step_s"),
    ("step_s = 1.0", "step_s = inf", "planner.step_s"),
    ("horizon = 3", "horizon = 0", "planner.horizon"),
    ("horizon = 3", "horizon = 1000000", "planner.horizon"),
    ("horizon = 3", "horizon = 3.0", "should be a whole number"),
    ("horizon = 3", "horizon = " + "9" * 5000, "digits"),
    ("horizon = 3", "horizon = 3\nmax_steps = 0", "planner.max_steps"),
    ("horizon = 3", "horizon = 3\nbudget_s = nan", "planner.budget_s"),
    ("horizon = 3", 'horizon = 3\nname = "lawnmower"', "not for task reach"),
    ("schema = 1", "schema = 2", "problem.schema"),
    ('name = "wrong"', 'name = "böse"', "problem.name"),
    ('name = "wrong"', 'name = "wrong"\ntask = "reech"', "problem.task"),
    ("[planner]", "[objective]\ncost_to_go = 'straight'\n[planner]", "objective.cost_to_go"),
]

POLYGONS = [
    ("{polygon = [[10, 10], [20, 20], [20, 10], [10, 20]]}", "has no area"),
    ("{polygon = [[10, 10], [10, 10], [10, 10]]}", "different corners"),
    ("{polygon = [[10, 10], [15, 15], [20, 20]]}", "has no area"),
    ("{polygon = []}", "world.obstacles[0].polygon"),
    ("{polygon = [[10, nan], [20, 20], [20, 10]]}", "world.obstacles[0].polygon[0][1]"),
    ("{polygon = [[1, 1], [10, 1], [10, 10], [1, 10]]}", "inside the obstacle obstacle 0"),
    ("{wkt = 'POINT (1 2)'}", "not an area"),
    ("{wkt = 'POLYGON ((10 10, 12 10, inf 12, 10 10))'}", "is not a place"),
    ("{file = 'none.geojson'}", "none.geojson"),
    ("{}", "exactly one of file, polygon and wkt"),
    ("3", "should be a table"),
]

VELOCITY = "velocity_m_s = [0.5, 0.0]"
SLOW = 'name = "a"\ndynamics = "double_integrator"\nacceleration_max_m_s2 = 1e-300'
TWIN = '[[robots]]\nname = "a"\nstart_m = [9.0, 9.0]\nspeed_max_m_s = 1.0\n[[stations]]'
TRACKED = [
    ('name = "a"', 'name = "a"\ngoal_m = [9.0, 9.0]', "has no robots.goal_m"),
    ('kind = "tracking"', 'kind = "tracker"', "objective.terms[0].kind"),
    ("sweet_spot_m = 1.0", "sweet_spot = 1.0", "did you mean sweet_spot_m?"),
    ("sweet_spot_m = 1.0", "sweet_spot_m = 1.0\nweight = -1.0", "terms[0].weight"),
    ("p_min = 0.8", "goal_radius_m = 2.0", "constraints.goal_radius_m"),
    (VELOCITY, "velocity_m_s = [nan, 0.0]", "targets[0].velocity_m_s[0]"),
    (VELOCITY, f"{VELOCITY}\nposition_std_m = 1e-300", "targets[0].position_std_m"),
    ('name = "a"', SLOW, "acceleration_max_m_s2"),
    ("[[stations]]", TWIN, "as that of robots[0] is"),
]

WHOLE = {
    "empty": (b"", "key problem: is missing"),
    "comment": (b"# nothing\n", "key problem: is missing"),
    "no TOML": (b"hello world", "is not TOML"),
    "JSON": (b'{"problem": 1}', "is not TOML"),
    "deep": (b"a = " + b"[" * 5000 + b"]" * 5000, "nested too deeply"),
    "NUL": (REACH.replace('"wrong"', '"wr\0ng"').encode(), "is not text"),
    "Latin-1": (REACH.replace('"wrong"', '"böse"').encode("latin-1"), "is not UTF-8"),
    "UTF-16": (REACH.encode("utf-16"), "is not UTF-8"),
    "binary": (bytes(range(256)), "is not UTF-8"),
}


def refused(capsys: pytest.CaptureFixture[str], tmp_path: Path, content: bytes) -> str:
    """The one line that `planopt solve` says of a file; exit code 2, and nothing written."""
    path, out = tmp_path / "wrong.toml", tmp_path / "out"
    path.write_bytes(content)
    assert main(["solve", str(path), "--out", str(out)]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and not out.exists()
    assert printed.err.startswith("planopt: ") and printed.err.count("\n") == 1
    assert "Traceback" not in printed.err
    return printed.err


@pytest.mark.parametrize(
    ("whole", "old", "new", "words"),
    [*((REACH, *each) for each in REPLACED), *((TRACK, *each) for each in TRACKED)],
)
def test_a_wrong_value(whole: str, old: str, new: str, words: str, tmp_path: Path, capsys) -> None:
    """The message names the key, or what does not fit."""
    assert old in whole
    assert words in refused(capsys, tmp_path, whole.replace(old, new, 1).encode())


@pytest.mark.parametrize(("entry", "words"), POLYGONS)
def test_a_wrong_obstacle(entry: str, words: str, tmp_path: Path, capsys) -> None:
    """Crossing itself, without area, not there, or where the robot is."""
    world = f"bounds_m = [0.0, 0.0, 50.0, 40.0]\nobstacles = [{entry}]"
    text = REACH.replace("bounds_m = [0.0, 0.0, 50.0, 40.0]", world)
    assert words in refused(capsys, tmp_path, text.encode())


@pytest.mark.parametrize("name", WHOLE)
def test_no_problem_file_at_all(name: str, tmp_path: Path, capsys) -> None:
    """Nothing in it, something else, or another encoding."""
    content, words = WHOLE[name]
    assert words in refused(capsys, tmp_path, content)


def test_a_folder(tmp_path: Path, capsys) -> None:
    """Where a file should be."""
    assert main(["solve", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_an_obstacle_that_is_soon_far_away(tmp_path: Path, capsys) -> None:
    """It is planned with, and drawn where it can be seen."""
    world = (
        "bounds_m = [0.0, 0.0, 50.0, 40.0]\n[[world.moving]]\nname = 'comet'\nradius_m = 1.0\n"
        "start_m = [30.0, 30.0]\nvelocity_m_s = [1e8, 0.0]"
    )
    path = tmp_path / "fast.toml"
    path.write_text(REACH.replace("bounds_m = [0.0, 0.0, 50.0, 40.0]", world))
    assert main(["solve", str(path), "--planner", "lattice", "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "plan.json").exists()
    capsys.readouterr()
