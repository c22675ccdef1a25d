"""Hostile files on the command line: one line of ours, exit code 2 at once, nothing written."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from refusals import refused_command

from planopt.cli import main

CORPUS = Path(__file__).parent / "hostile_files"
"""Files that once ended in a traceback, in gigabytes or in the content of another file."""

PROBLEM = """
[problem]
schema = 1
name = "hostile"
task = "map"
[world]
bounds_m = [0.0, 0.0, 60.0, 60.0]
[channel.truth]
kind = "model"
k_pl_db = -10.0
n_pl = 2.0
shadow_std_db = 4.0
decorrelation_m = 10.0
multipath_std_db = 2.0
cell_m = 0.5
[channel.measurements]
count = 16
[[robots]]
name = "rover"
start_m = [8.0, 8.0]
speed_max_m_s = 5.5
[[stations]]
position_m = [0.0, 0.0]
height_m = 2.0
transmit_power_dbm = 0.0
threshold_dbm = -45.0
[[objective.terms]]
kind = "mapping"
form = "information"
[planner]
step_s = 1.0
horizon = 3
max_steps = 2
[report]
figures = false
"""

OWN_TERM = """[[objective.terms]]
kind = "casadi"
steps = 3
program = "mean_db[2, 0] / 0.0"
"""


@pytest.fixture(autouse=True)
def soon() -> Iterator[None]:
    begun = time.process_time()
    yield
    assert time.process_time() - begun < 20.0


def simulated(folder: Path, capsys: pytest.CaptureFixture[str], *replaced: str) -> None:
    """Expect an error about a problem in which pairs of texts were replaced; no folder is left."""
    text = PROBLEM
    for old, new in zip(replaced[::2], replaced[1::2], strict=True):
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "p.toml").write_text(text)
    refused_command(capsys, "simulate", folder / "p.toml", "--out", folder / "out")
    assert not (folder / "out").exists()


def test_the_problem_itself_is_sound(tmp_path: Path, capsys) -> None:
    (tmp_path / "p.toml").write_text(PROBLEM)
    assert main(["simulate", str(tmp_path / "p.toml"), "--out", str(tmp_path / "out")]) == 0
    capsys.readouterr()


BOUNDS = "bounds_m = [0.0, 0.0, 60.0, 60.0]"
ROBOT = '[[robots]]\nname = "r"\nstart_m = [8.0, 8.0]\nspeed_max_m_s = 5.5\n'
LONG = "n" * 100_000
MAPPING = '[[objective.terms]]\nkind = "mapping"\nform = "information"\n'
PROBLEMS = {
    # It was found after all the work, when the plan was written.
    "a name that no file can hold": (BOUNDS, f'{BOUNDS}\n[[world.obstacles]]\nfile = "o.geojson"'),
    "a lattice of many gigabytes": (
        *("60.0, 60.0]", "60000.0, 60000.0]"),
        *("cell_m = 0.5", "cell_m = 60.0"),
    ),
    "an expression without a value": (MAPPING, OWN_TERM, '"map"', '"custom"'),
    "too many robots": ("[[stations]]", ROBOT * 20 + "[[stations]]"),
    "a long value": ('name = "hostile"', f'name = "{LONG}"'),
    "a long key": ('name = "hostile"', f'{LONG} = "{LONG}"'),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_hostile_problems(name: str, tmp_path: Path, capsys) -> None:
    """File and key are named, in few words."""
    geometry = {"type": "Polygon", "coordinates": [[[30, 40], [40, 40], [40, 50], [30, 40]]]}
    feature = {"type": "Feature", "properties": {"name": "\ud800"}, "geometry": geometry}
    (tmp_path / "o.geojson").write_text(json.dumps(feature))
    simulated(tmp_path, capsys, *PROBLEMS[name])


@pytest.mark.parametrize("command", ["fit", "map", "solve", "check"])
@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no devices")
def test_devices_and_pipes(command: str, tmp_path: Path, capsys) -> None:
    """Every command that reads a file refuses them without waiting."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "plan.json").symlink_to("/dev/zero")
    more = {
        "fit": ["--station", "0,0"],
        "map": ["--station", "0,0", "--out", str(tmp_path / "m.csv")],
    }
    files = ["/dev/zero", str(tmp_path / "pipe")] if command != "check" else [str(tmp_path)]
    for file in files:
        refused_command(capsys, command, file, *more.get(command, []))


def test_files_that_no_parser_should_read(tmp_path: Path, capsys) -> None:
    """A sparse terabyte, keys whose parsing takes quadratic time, and a name that is no text."""
    file = tmp_path / "p.toml"
    file.touch()
    os.truncate(file, 2**40)
    refused_command(capsys, "solve", file)
    file.write_text("x = 1\n" + ".".join(["a"] * 100_000) + " = 1\n")
    refused_command(capsys, "solve", file)
    refused_command(capsys, "solve", "a\udcff.toml")


@pytest.mark.parametrize("station", ["unknown", "0,0", "50,0", "0,0,5"])
def test_positions_closer_than_resolution(station: str, tmp_path: Path, capsys) -> None:
    """Squares of their distances are zero, and no fit is."""
    rows = [f"{(-1) ** i * i}e-301,{i * i}e-301,{30 + i}" for i in range(1, 11)]
    (tmp_path / "log.csv").write_text("\n".join(["x_m,y_m,power_dbm", *rows]))
    refused_command(capsys, "fit", tmp_path / "log.csv", "--station", station)


def test_places_of_which_some_are_too_near(tmp_path: Path, capsys) -> None:
    rows = [f"{i}e-301,0,{-30 - i}" for i in range(5)] + [f"{i},{i},{-50 - i}" for i in range(9)]
    (tmp_path / "log.csv").write_text("\n".join(["x_m,y_m,power_dbm", *rows]))
    assert main(["fit", str(tmp_path / "log.csv"), "--station", "50,0"]) in (0, 3)
    capsys.readouterr()


def test_files_that_broke_a_reader(tmp_path: Path) -> None:
    """In a process with 4 GB of address space, since a library may end its process."""
    script = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
from planopt.channel import (read_log)
from planopt import (InputError)
from planopt.world.occupancy import read_grid
from planopt.world.raster_files import read_raster
for path in sorted(Path(sys.argv[1]).iterdir()):
    if path.suffix == ".yaml":
        read = read_grid
    elif path.suffix == ".csv":
        read = read_log
    elif path.suffix == ".txt":
        continue
    else:
        read = lambda path: read_raster(path, "path_gain_db")
    try:
        read(path)
    except InputError:
        print(path.name)
"""
    done = subprocess.run(
        [sys.executable, "-c", script, str(CORPUS)], capture_output=True, text=True, timeout=120
    )
    bad = {path.name for path in CORPUS.iterdir()} - {"secret.txt", "tiny_places.csv"}
    assert (done.returncode, done.stderr, set(done.stdout.split())) == (0, "", bad)
    assert main(["fit", str(CORPUS / "tiny_places.csv"), "--station", "0,0"]) == 2
