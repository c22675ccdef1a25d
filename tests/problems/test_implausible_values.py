"""Warnings about values that are valid but implausible, in words and as JSON."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from refusals import refused_command

import planopt
from planopt.cli import main
from planopt.problems.library import library_folder

FIELD = (library_folder() / "open_field.toml").read_text()
WALL = '[[world.obstacles]]\nname = "bar"\npolygon = [[70, 0], [72, 0], [72, 100], [70, 100]]\n\n'
GRID = '[[world.obstacles]]\nfile = "yard.yaml"\n\n'
YAML = """image: yard.pgm
resolution: {resolution}
origin: [0.0, 60.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: {free}
"""


def warned(command: str, path: Path, capsys) -> str:
    """What a command prints about a problem, its JSON included."""
    assert main([command, str(path)]) == 0
    text = capsys.readouterr().out
    if command == "validate":
        assert main([command, str(path), "--json"]) == 0
        for words in json.loads(capsys.readouterr().out)["warnings"]:
            assert words in text
    return text


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("threshold_dbm = -59.0", "threshold_dbm = 59.0", "threshold_dbm 59 dBm is implausible"),
        ("step_s = 2.0", "step_s = 2000", "m in a step, in a world"),
        ("position_m = [60.0, 8.0]", "position_m = [691000, 5348000]", "5,392 km from the world"),
        ("[channel.truth]", f"{WALL}[channel.truth]", "separate the goal robots[0].goal_m"),
    ],
)
def test_implausible_problems(old: str, new: str, words: str, tmp_path: Path, capsys) -> None:
    assert old in FIELD
    path = tmp_path / "field.toml"
    path.write_text(FIELD.replace(old, new))
    assert words in warned("validate", path, capsys)


@pytest.mark.parametrize(
    ("resolution", "free", "words"),
    [
        (0.25, 0.25, "15.0 % of the cells are grey 205"),
        (0.25, 0.196, "15.0 % of the cells are unknown and count as occupied"),
        (25.0, 0.25, "cells of 25 m are implausibly large"),
    ],
)
@pytest.mark.parametrize("command", ["validate", "show"])
def test_occupancy_grids(
    command: str, resolution: float, free: float, words: str, tmp_path: Path, capsys
) -> None:
    """Unknown cells are counted, whether free or occupied, and cells of metres are named."""
    grey = np.full((20, 20), 254, dtype=np.uint8)
    grey[:3] = 205
    Image.fromarray(grey).save(tmp_path / "yard.pgm")
    (tmp_path / "yard.yaml").write_text(YAML.format(resolution=resolution, free=free))
    path = tmp_path / "field.toml"
    path.write_text(FIELD.replace("[channel.truth]", f"{GRID}[channel.truth]"))
    assert f"yard.yaml: {words}" in warned(command, path, capsys)


LATITUDE, LONGITUDE = 48.1374, 11.5755
METRES_PER_DEGREE = 111_198.0


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Powers about a station 20 m north and 30 m west of the origin, in degrees and metres."""
    generator = np.random.default_rng(2)
    places = generator.uniform(-80.0, 80.0, (80, 2))
    power = -40.0 - 25.0 * np.log10(np.hypot(*(places - (-30.0, 20.0)).T))
    power += generator.normal(0.0, 2.0, 80)
    lat = LATITUDE + places[:, 1] / METRES_PER_DEGREE
    lon = LONGITUDE + places[:, 0] / METRES_PER_DEGREE / np.cos(np.radians(LATITUDE))
    table = np.column_stack([lat, lon, *places.T, power, -power, 10.0 ** (power / 10.0)])
    path = tmp_path / "log.csv"
    header = "lat,lon,x,y,dbm,loss,linear"
    np.savetxt(path, table, "%.12g", delimiter=",", header=header, comments="")
    return path


def fitted(log: Path, columns: str, station: str, capsys, *options: str) -> tuple[int, dict]:
    arguments = [f"--station={station}", "--columns", columns, "--json", *options]
    code = main(["fit", str(log), *arguments])
    return code, json.loads(capsys.readouterr().out)


def test_a_station_in_degrees(log: Path, capsys) -> None:
    """With an origin the station is LAT,LON, and the fit is that in metres, which are printed."""
    lat = LATITUDE + 20.0 / METRES_PER_DEGREE
    lon = LONGITUDE - 30.0 / METRES_PER_DEGREE / np.cos(np.radians(LATITUDE))
    origin = ("--origin", f"{LATITUDE},{LONGITUDE}")
    _, degrees = fitted(log, "x=lon,y=lat,power=dbm", f"{lat},{lon},6", capsys, *origin)
    _, metres = fitted(log, "x=x,y=y,power=dbm", "-30,20,6", capsys)
    assert degrees["station"] == pytest.approx([-30.0, 20.0], abs=0.2)
    assert degrees["station_height_m"] == 6.0
    assert degrees["n_pl"] == pytest.approx(metres["n_pl"], rel=0.05)
    for metres in ("-30,20", "-30,20,6"):
        arguments = ["fit", str(log), f"--station={metres}", "--columns", "x=lon,y=lat,power=dbm"]
        refused_command(capsys, *arguments, *origin)


@pytest.mark.parametrize(
    ("columns", "words", "code"),
    [
        ("x=lon,y=lat,power=dbm", "look like degrees", 3),
        ("x=x,y=y,power=loss", "write the minus sign", 3),
        ("x=x,y=y,power=linear", "in mW, as their values show", 3),
    ],
)
def test_logs_in_other_units(columns: str, words: str, code: int, log: Path, capsys) -> None:
    """The warning comes first; a degenerate fit has an exit code of its own."""
    found, data = fitted(log, columns, "-30,20", capsys)
    assert words in data["warnings"][0]
    assert found == code and (data["status"] == "degenerate") == (code == 3)


def test_milliwatts_and_degenerate_fits(log: Path, capsys) -> None:
    """An unknown station names the unit; a degenerate fit is printed and has exit code 3."""
    arguments = ["fit", str(log), "--station=unknown", "--columns", "x=x,y=y,power=linear"]
    refused_command(capsys, *arguments, "--power-unit", "dBm")
    _, linear = fitted(log, "x=x,y=y,power=linear", "unknown", capsys)
    _, dbm = fitted(log, "x=x,y=y,power=dbm", "unknown", capsys)
    assert linear["station"] == pytest.approx(dbm["station"], abs=0.1)
    code, data = fitted(log, "x=lon,y=lat,power=dbm", "-30,20", capsys)
    assert (code, data["status"]) == (3, "degenerate")


@pytest.mark.parametrize(
    ("moved_m", "power_dbm", "words"),
    [(50.0, -60.0, "from where its plan led"), (0.0, 60.0, "most powers of measurements")],
)
def test_own_loops_are_warned(moved_m: float, power_dbm: float, words: str) -> None:
    """A jump and a power without its sign are used, with a warning."""
    problem = planopt.load("open_field")
    problem = replace(problem, planner=replace(problem.planner, horizon=2))
    planner = planopt.Planner(problem)
    here = planner.step(problem.robots[0].start_m).next_position_m + (moved_m, 0.0)
    with pytest.warns(UserWarning, match=words):
        planner.step(here, planopt.Measurements([here], [power_dbm]))
