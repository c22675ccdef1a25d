"""Hostile files on the command line: one line of ours, exit code 2 at once, nothing written."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

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


def refused(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """The one line of a command that must fail soon, with exit code 2."""
    begun = time.process_time()
    assert main(arguments) == 2
    assert time.process_time() - begun < 5.0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("planopt: ") and printed.err.count("\n") == 1
    assert printed.err.strip().isprintable() and len(printed.err) < 1500
    return printed.err


def simulated(folder: Path, capsys: pytest.CaptureFixture[str], *replaced: str) -> str:
    """The one line about a problem in which pairs of texts were replaced; no folder is left."""
    text = PROBLEM
    for old, new in zip(replaced[::2], replaced[1::2], strict=True):
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "p.toml").write_text(text)
    error = refused(capsys, ["simulate", str(folder / "p.toml"), "--out", str(folder / "out")])
    assert not (folder / "out").exists()
    return error


def test_the_problem_itself_is_sound(tmp_path: Path, capsys) -> None:
    """What the tests below damage."""
    (tmp_path / "p.toml").write_text(PROBLEM)
    assert main(["simulate", str(tmp_path / "p.toml"), "--out", str(tmp_path / "out")]) == 0
    capsys.readouterr()


def test_a_name_that_no_file_can_hold(tmp_path: Path, capsys) -> None:
    """It was found after all the work, when the plan was written."""
    geometry = {"type": "Polygon", "coordinates": [[[30, 40], [40, 40], [40, 50], [30, 40]]]}
    feature = {"type": "Feature", "properties": {"name": "\ud800"}, "geometry": geometry}
    (tmp_path / "o.geojson").write_text(json.dumps(feature))
    world = 'bounds_m = [0.0, 0.0, 60.0, 60.0]\n[[world.obstacles]]\nfile = "o.geojson"'
    error = simulated(tmp_path, capsys, "bounds_m = [0.0, 0.0, 60.0, 60.0]", world)
    assert "o.geojson" in error and "\\ud800" in error


def test_a_world_whose_lattice_takes_many_gigabytes(tmp_path: Path, capsys) -> None:
    """The key and the estimate are named, and horizons count."""
    error = simulated(
        tmp_path, capsys, "60.0, 60.0]", "60000.0, 60000.0]", "cell_m = 0.5", "cell_m = 60.0"
    )
    assert "key planner.step_s" in error and "GB" in error and "world.bounds_m" in error


def test_an_expression_without_a_value(tmp_path: Path, capsys) -> None:
    """File and index of the term are named."""
    error = simulated(
        tmp_path,
        capsys,
        '[[objective.terms]]\nkind = "mapping"\nform = "information"\n',
        OWN_TERM,
        '"map"',
        '"custom"',
    )
    assert "p.toml, key objective.terms[0].program: is inf" in error


def test_too_many_robots(tmp_path: Path, capsys) -> None:
    """How many there are is said, not which."""
    robot = '[[robots]]\nname = "r"\nstart_m = [8.0, 8.0]\nspeed_max_m_s = 5.5\n'
    error = simulated(tmp_path, capsys, "[[stations]]", robot * 20 + "[[stations]]")
    assert "key robots: has 21 entries, should have at most 20" in error and len(error) < 300


@pytest.mark.parametrize("key", ["name", "n" * 100_000])
def test_names_of_a_hundred_thousand_letters(key: str, tmp_path: Path, capsys) -> None:
    """As value and as key: the beginning is enough."""
    error = simulated(tmp_path, capsys, 'name = "hostile"', f'{key} = "{"n" * 100_000}"')
    assert len(error) < 800


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
        refused(capsys, [command, file, *more.get(command, [])])


def test_an_endless_problem_file(tmp_path: Path, capsys) -> None:
    """A sparse file of a terabyte is not read."""
    (tmp_path / "p.toml").touch()
    os.truncate(tmp_path / "p.toml", 2**40)
    assert "more than the limit of 2 MB" in refused(capsys, ["solve", str(tmp_path / "p.toml")])


def test_a_key_of_thousands_of_parts(tmp_path: Path, capsys) -> None:
    """The parser would take time that grows with their square."""
    (tmp_path / "p.toml").write_text("x = 1\n" + ".".join(["a"] * 100_000) + " = 1\n")
    assert "line 2: " in refused(capsys, ["solve", str(tmp_path / "p.toml")])


def test_an_argument_that_is_no_text(capsys) -> None:
    """Bytes of a file name that are not UTF-8."""
    assert "is not UTF-8" in refused(capsys, ["solve", "a\udcff.toml"])


@pytest.mark.parametrize("station", ["unknown", "0,0", "50,0", "0,0,5"])
def test_places_nearer_than_any_receiver_can_tell(station: str, tmp_path: Path, capsys) -> None:
    """Squares of their distances are zero, and no fit is."""
    rows = [f"{(-1) ** i * i}e-301,{i * i}e-301,{30 + i}" for i in range(1, 11)]
    (tmp_path / "log.csv").write_text("\n".join(["x_m,y_m,power_dbm", *rows]))
    error = refused(capsys, ["fit", str(tmp_path / "log.csv"), "--station", station])
    assert ("log.csv" in error and "one place" in error) or "at the station" in error


def test_places_of_which_some_are_too_near(tmp_path: Path, capsys) -> None:
    """A fit of the rest."""
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
from planopt.channel.power_log import read_log
from planopt.errors import InputError
from planopt.world.occupancy_files import read_grid
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
    refused = {path.name for path in CORPUS.iterdir()} - {"secret.txt", "tiny_places.csv"}
    assert (done.returncode, done.stderr, set(done.stdout.split())) == (0, "", refused)
    assert main(["fit", str(CORPUS / "tiny_places.csv"), "--station", "0,0"]) == 2
