"""Sound inputs of every format that planopt reads, small ones, and the commands that read them."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from planopt.cli import main
from planopt.problems.library import library_folder
from planopt.world.occupancy_files import CSV_HEADER
from planopt.world.raster import Raster
from planopt.world.raster_files import write_rasters

PROBLEM = """
[problem]
schema = 1
name = "small"
task = "map"
[world]
bounds_m = [0.0, 0.0, 20.0, 20.0]
{obstacles}
[channel.truth]
{truth}
[channel.measurements]
count = 12
[[robots]]
name = "rover"
start_m = [2.0, 2.0]
speed_max_m_s = 2.0
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
horizon = 1
max_steps = 2
[report]
figures = false
"""
MODEL = """kind = "model"
k_pl_db = -10.0
n_pl = 2.0
shadow_std_db = 4.0
decorrelation_m = 10.0
multipath_std_db = 2.0
cell_m = 1.0"""
MAP = 'kind = "raster"\nfile = "map{ending}"\nvariable = "path_gain_db"\nfloor_db = -130.0'
OBSTACLES = '[[world.obstacles]]\nfile = "obstacles{ending}"'
BLOCKS = (((6.0, 6.0), (9.0, 6.0), (9.0, 9.0), (6.0, 9.0)), ((12.0, 3.0), (15.0, 4.0), (13.0, 8.0)))
ROS_MAP = """image: obstacles.{image}
resolution: 1.0
origin: [4.0, 4.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


@dataclass(frozen=True)
class Sound:
    """Files in a folder, one of which is to be damaged, and what reads them.

    Attributes
    ----------
    name
        Of the format.
    folder
        Everything that the command needs.
    damaged
        Names of the files that take damage, one at a time.
    command
        Arguments of planopt, of which ``{folder}`` stands for a copy of the folder, ``{out}``
        for an output.
    """

    name: str
    folder: Path
    damaged: tuple[str, ...]
    command: tuple[str, ...]


def sound_files(root: Path) -> list[Sound]:
    """Write all of them below `root`."""
    solve = ("solve", "{folder}/p.toml", "--out", "{out}")
    found: list[Sound] = []

    def add(name: str, problem: str, files: Sequence[str], command: Sequence[str] = solve) -> Path:
        folder = root / name
        folder.mkdir(parents=True)
        if problem:
            (folder / "p.toml").write_text(problem)
        found.append(Sound(name, folder, tuple(files), tuple(command)))
        return folder

    add("problem", PROBLEM.format(obstacles="", truth=MODEL), ["p.toml"])
    for ending in (".npz", ".csv", ".nc", ".tif"):
        text = PROBLEM.format(obstacles="", truth=MAP.format(ending=ending))
        folder = add(f"map{ending}", text, [f"map{ending}"])
        write_rasters(folder / f"map{ending}", {"path_gain_db": _raster()})
    text = PROBLEM.format(obstacles="", truth=MAP.format(ending=".nc"))
    _write_netcdf_4(add("map4.nc", text, ["map.nc"]) / "map.nc")
    for name, content in _obstacle_files().items():
        ending = f".{name.rpartition('.')[2]}"
        text = PROBLEM.format(obstacles=OBSTACLES.format(ending=ending), truth=MODEL)
        (add(name, text, [f"obstacles{ending}"]) / f"obstacles{ending}").write_text(content)
    for image in ("pgm", "png"):
        text = PROBLEM.format(obstacles=OBSTACLES.format(ending=".yaml"), truth=MODEL)
        folder = add(f"ros_{image}", text, ["obstacles.yaml", f"obstacles.{image}"])
        (folder / "obstacles.yaml").write_text(ROS_MAP.format(image=image))
        Image.fromarray(_shades()).save(folder / f"obstacles.{image}")
    # Without --out, as pictures take most of the time.
    fit = ("fit", "{folder}/log.csv", "--station", "0,0,2")
    for method in ("lemma1", "convex", "reml"):
        folder = add(f"log_{method}", "", ["log.csv"], (*fit, "--method", method))
        (folder / "log.csv").write_text(_log())
    columns = ("--censored", "cut", "--time", "t_s", "--receiver", "who", "--where", "day=1")
    places = ("--origin", "48.1,11.5", "--columns", "x=lon,y=lat,power=rssi")
    folder = add("log_columns", "", ["log.csv"], (*fit, *columns, *places))
    (folder / "log.csv").write_text(_log_with_columns())
    problem = PROBLEM.format(obstacles="", truth=MODEL)
    folder = add("log_measured", problem.replace("count = 12", 'file = "log.csv"'), ["log.csv"])
    (folder / "log.csv").write_text(_log(scale=0.4))
    for name, text, *command in (
        ("saved_plan", problem, "solve", "--horizon", "3"),
        ("saved_run", problem, "simulate"),
        ("saved_reach", _short("open_field", "max_steps = 200"), "simulate", "--horizon", "2"),
        ("saved_team", _short("harbour_track", "max_steps = 45"), "simulate", "--horizon", "2"),
        ("saved_stations", _short("two_station_courier", ""), "solve", "--horizon", "3"),
    ):
        folder = add(name, text, [], ("check", "{folder}/saved"))
        written(folder, command, found)
    again = ("compare", "{folder}/p.toml", "--horizons", "1", "--seeds", "1")
    folder = add("finished_runs", problem, [], (*again, "--out", "{folder}/saved"))
    written(folder, again, found)
    return found


def written(folder: Path, command: Sequence[str], found: list[Sound]) -> None:
    """Let a command write results into a folder; they are what is damaged of the last input."""
    out = folder / "saved"
    name, *more = command
    arguments = [argument.format(folder=folder) for argument in more]
    problem = [] if name == "compare" else [str(folder / "p.toml")]
    code = main([name, *problem, *arguments, "--out", str(out), "--json"])
    assert code in (0, 3, 4), code
    paths = sorted(path for path in out.rglob("*") if path.is_file())
    names = tuple(str(path.relative_to(folder)) for path in paths)
    found[-1] = replace(found[-1], damaged=names)


def copied(sound: Sound, to: Path) -> list[str]:
    """Copy the files of an input; return the command with its places filled in."""
    shutil.rmtree(to, ignore_errors=True)
    shutil.copytree(sound.folder, to / "in")
    places = {"folder": str(to / "in"), "out": str(to / "out")}
    return [argument.format(**places) for argument in sound.command]


def _raster() -> Raster:
    x, y = np.arange(0.5, 20.0), np.arange(0.5, 20.0)
    values = -30.0 - 20.0 * np.log10(1.0 + np.hypot(x[None, :], y[:, None]))
    return Raster(x, y, values)


def _write_netcdf_4(path: Path) -> None:
    import h5netcdf

    raster = _raster()
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"y": len(raster.y_m), "x": len(raster.x_m)}
        file.create_variable("y", ("y",), data=raster.y_m)
        file.create_variable("x", ("x",), data=raster.x_m)
        data = {"data": raster.values, "chunks": (7, 7), "compression": "gzip"}
        file.create_variable("path_gain_db", ("y", "x"), **data)


def _obstacle_files() -> dict[str, str]:
    rings = [[list(corner) for corner in (*block, block[0])] for block in BLOCKS]
    features = [
        {
            "type": "Feature",
            "properties": {"name": f"block {index}"},
            "geometry": {"type": "Polygon", "coordinates": [ring]},
        }
        for index, ring in enumerate(rings)
    ]
    buildings = [{"name": f"b{i}", "exterior": ring[:-1]} for i, ring in enumerate(rings)]
    corners = [", ".join(f"{x} {y}" for x, y in ring) for ring in rings]
    rows = "\n".join(",".join("1" if v < 90 else "0" for v in row) for row in _shades().tolist())
    return {
        "obstacles.geojson": json.dumps({"type": "FeatureCollection", "features": features}),
        "buildings.json": json.dumps({"buildings": buildings}),
        "obstacles.wkt": "\n".join(f"POLYGON (({ring}))" for ring in corners),
        "grid.csv": f"{','.join(CSV_HEADER)}\n1.0,4.0,4.0,0.5\n{rows}\n",
    }


def _shades() -> np.ndarray:
    shades = np.full((12, 12), 254, dtype=np.uint8)
    shades[2:5, 2:6], shades[7:10, 8] = 0, 0
    return shades


def _short(name: str, max_steps: str) -> str:
    """A problem of the library whose runs have three steps, without pictures."""
    text = (library_folder() / f"{name}.toml").read_text()
    assert max_steps in text
    text = text.replace(max_steps, "max_steps = 3") if max_steps else text
    head = text.partition("[report]")[0]
    return f"{head}\n[report]\nfigures = false\n"


def _measured() -> list[tuple[float, float, float]]:
    """Places and powers."""
    found: list[tuple[float, float, float]] = []
    for i in range(40):
        x, y = 3.0 + (7 * i) % 40, 2.0 + (11 * i) % 37
        power = -30.0 - 25.0 * math.log10(math.hypot(x, y)) + 4.0 * math.sin(i)
        found.append((x, y, power))
    return found


def _log(scale: float = 1.0) -> str:
    rows = [f"{scale * x:.2f},{scale * y:.2f},{power:.3f}" for x, y, power in _measured()]
    return "\n".join(["x_m,y_m,power_dbm", *rows]) + "\n"


def _log_with_columns() -> str:
    rows = [
        f"{48.1 + 1e-5 * y:.6f},{11.5 + 1e-5 * x:.6f},{power:.1f},{i % 7 == 0:d},{i},{'ab'[i % 2]},"
        f"{i // 30 + 1}"
        for i, (x, y, power) in enumerate(_measured())
    ]
    return "\n".join(["lat,lon,rssi,cut,t_s,who,day", *rows]) + "\n"
