"""Wrong problem files of every kind: one line of ours, exit code 2, nothing written."""

from pathlib import Path

import pytest
from refusals import refused_command

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

# The text of the file that is replaced, and what replaces it; more in problems/test_refused.py.
REPLACED = [
    ("[0.0, 0.0, 50.0, 40.0]", "[nan, 0.0, 50.0, 40.0]"),
    ("[0.0, 0.0, 50.0, 40.0]", "[0.0, 0.0, 9e6, 9e6]"),
    ("[0.0, 0.0, 50.0, 40.0]", "[0.0, 0.0, 50.0, 40.0]\nobstacles = [3]"),
    ("[0.0, 0.0, 50.0, 40.0]", "[0, 0, 50, 40]\nobstacles = [{wkt = 'POINT (1 2)'}]"),
    ("[0.0, 0.0, 50.0, 40.0]", "[0, 0, 50, 40]\nobstacles = [{file = 'none.geojson'}]"),
    ("[0.0, 0.0, 50.0, 40.0]", "[0, 0, 50, 40]\nobstacles = [{polygon = [[9, 9], [9, 9]]}]"),
    ("cell_m = 1.0", "cell_m = 1e-9"),
    ("count = 50", "count = 1979-05-27"),
    ("count = 50", 'file = "."'),
    ("speed_max_m_s = 1.0", "speed_max_m_s = 1e-300"),
    ("speed_max_m_s = 1.0", "speed_max_m_s = 0.002"),
    ("[[robots]]", "[robots]"),
    ("position_m = [25.0, 5.0]", "position_m = [1e12, 5.0]"),
    ("p_min = 0.8", "p_min = 0.8\np_min = 0.9"),
    ("step_s = 1.0", "step_s = inf"),
    ("horizon = 3", "horizon = " + "9" * 5000),
    ("horizon = 3", "horizon = 3\nbudget_s = nan"),
    ('name = "wrong"', 'name = "böse"'),
    ('name = "wrong"', 'name = "wrong"\ntask = "reech"'),
    ("[planner]", "[objective]\ncost_to_go = 'straight'\n[planner]"),
]
VELOCITY = "velocity_m_s = [0.5, 0.0]"
SLOW = 'name = "a"\ndynamics = "double_integrator"\nacceleration_max_m_s2 = 1e-300'
TRACKED = [
    ("sweet_spot_m = 1.0", "sweet_spot = 1.0"),
    ("sweet_spot_m = 1.0", "sweet_spot_m = 1.0\nweight = -1.0"),
    (VELOCITY, "velocity_m_s = [nan, 0.0]"),
    (VELOCITY, f"{VELOCITY}\nposition_std_m = 1e-300"),
    ('name = "a"', SLOW),
]

WHOLE = {
    "empty": b"",
    "comment": b"# nothing\n",
    "no TOML": b"hello world",
    "JSON": b'{"problem": 1}',
    "deep": b"a = " + b"[" * 5000 + b"]" * 5000,
    "NUL": REACH.replace('"wrong"', '"wr\0ng"').encode(),
    "Latin-1": REACH.replace('"wrong"', '"böse"').encode("latin-1"),
    "UTF-16": REACH.encode("utf-16"),
    "binary": bytes(range(256)),
}


def refuses(capsys: pytest.CaptureFixture[str], tmp_path: Path, content: bytes) -> None:
    """`planopt solve` reports one error of a file and writes nothing."""
    path, out = tmp_path / "wrong.toml", tmp_path / "out"
    path.write_bytes(content)
    refused_command(capsys, "solve", path, "--out", out)
    assert not out.exists()


@pytest.mark.parametrize(
    ("whole", "old", "new"),
    [*((REACH, *each) for each in REPLACED), *((TRACK, *each) for each in TRACKED)],
)
def test_a_wrong_value(whole: str, old: str, new: str, tmp_path: Path, capsys) -> None:
    """The message names the key, or what does not fit."""
    assert old in whole
    refuses(capsys, tmp_path, whole.replace(old, new, 1).encode())


@pytest.mark.parametrize("name", WHOLE)
def test_no_problem_file_at_all(name: str, tmp_path: Path, capsys) -> None:
    """Nothing in it, something else, or another encoding."""
    refuses(capsys, tmp_path, WHOLE[name])


def test_a_folder(tmp_path: Path, capsys) -> None:
    refused_command(capsys, "solve", tmp_path)


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
