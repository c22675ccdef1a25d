"""Small sound inputs of every format that planopt reads, with the commands that read them."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import h5netcdf
import numpy as np
from PIL import Image

from planopt.cli import main
from planopt.problems.library import library_folder
from planopt.world import Raster, write_rasters

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
ROS_MAP = """image: obstacles.{image}
resolution: 1.0
origin: [4.0, 4.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
SQUARE = [[6.0, 6.0], [9.0, 6.0], [9.0, 9.0], [6.0, 6.0]]
FEATURE = {"type": "Feature", "properties": {"name": "block"}}
OBSTACLES = {
    "obstacles.geojson": json.dumps(
        {**FEATURE, "geometry": {"type": "Polygon", "coordinates": [SQUARE]}}
    ),
    "obstacles.json": json.dumps({"buildings": [{"name": "b", "exterior": SQUARE[:-1]}]}),
    "obstacles.wkt": "POLYGON ((6 6, 9 6, 9 9, 6 6))\nPOLYGON ((12 3, 15 4, 13 8, 12 3))",
    "obstacles.csv": "resolution_m,origin_x_m,origin_y_m,occupied_from\n1,4,4,0.5\n0,1\n1,-1\n",
}
SAVED = {
    "saved_plan": ("", "", "solve", "--horizon", "3"),
    "saved_run": ("", "", "simulate"),
    "saved_reach": ("open_field", "max_steps = 200", "simulate", "--horizon", "2"),
    "saved_team": ("harbour_track", "max_steps = 45", "simulate", "--horizon", "2"),
    "saved_stations": ("two_station_courier", "horizon", "solve", "--horizon", "3"),
}

Write = Callable[[Path], object]


def write_inputs(root: Path) -> None:
    """Write a folder for each input: its files, and ``case.json`` with command and damaged files.

    In commands ``{folder}`` stands for a copy of the folder and ``{out}`` for an output.
    """
    small = PROBLEM.format(obstacles="", truth=MODEL)
    solve = ("solve", "{folder}/p.toml", "--out", "{out}")

    def add(name: str, files: dict[str, str | Write], command: Sequence[str] = solve) -> None:
        (root / name).mkdir(parents=True)
        for file, content in files.items():
            if isinstance(content, str):
                (root / name / file).write_text(content)
            else:
                content(root / name / file)
        damaged = [file for file in files if len(files) == 1 or file != "p.toml"]
        case = {"command": command, "damaged": damaged}
        (root / name / "case.json").write_text(json.dumps(case))

    add("problem", {"p.toml": small})
    maps: dict[str, Write] = {ending: _write_map for ending in (".npz", ".csv", ".nc", ".tif")}
    for ending, write in (*maps.items(), (".nc", _write_netcdf_4)):
        text = PROBLEM.format(obstacles="", truth=MAP.format(ending=ending))
        add(f"map{ending} by {write.__name__}", {"p.toml": text, f"map{ending}": write})
    for file, content in OBSTACLES.items():
        text = f'[[world.obstacles]]\nfile = "{file}"'
        add(file, {"p.toml": PROBLEM.format(obstacles=text, truth=MODEL), file: content})
    for image in ("pgm", "png"):
        text = PROBLEM.format(obstacles='[[world.obstacles]]\nfile = "o.yaml"', truth=MODEL)
        ros = ROS_MAP.format(image=image)
        add(f"ros {image}", {"p.toml": text, "o.yaml": ros, f"obstacles.{image}": _write_image})
    # Without --out, since pictures take most of the time.
    fit = ("fit", "{folder}/log.csv", "--station", "0,0,2")
    for method in ("lemma1", "convex", "reml"):
        add(f"log {method}", {"log.csv": _log()}, (*fit, "--method", method))
    columns = ("--censored", "cut", "--time", "t_s", "--receiver", "who", "--where", "day=1")
    places = ("--origin", "48.1,11.5", "--columns", "x=lon,y=lat,power=rssi")
    degrees = ("fit", "{folder}/log.csv", "--station", "48.1,11.5,2")
    add("log columns", {"log.csv": _log_with_columns()}, (*degrees, *columns, *places))
    measured = small.replace("count = 12", 'file = "log.csv"')
    add("log measured", {"p.toml": measured, "log.csv": _log(0.4)})
    for name, (library, steps, *command) in SAVED.items():
        add(name, {"p.toml": _short(library, steps) if library else small})
        _run(root / name, command, ("check", "{folder}/saved"))
    add("finished runs", {"p.toml": small})
    command = ("compare", "--horizons", "1", "--seeds", "1")
    _run(
        root / "finished runs",
        command,
        (command[0], "{folder}/p.toml", *command[1:], "--out", "{folder}/saved"),
    )


def _run(folder: Path, command: Sequence[str], reader: Sequence[str]) -> None:
    """Let a command save results, which are the damaged files of the input."""
    name, *more = command
    out = folder / "saved"
    code = main([name, str(folder / "p.toml"), *more, "--out", str(out), "--json"])
    assert code in (0, 3, 4), code
    files = sorted(str(path.relative_to(folder)) for path in out.rglob("*") if path.is_file())
    (folder / "case.json").write_text(json.dumps({"command": reader, "damaged": files}))


def _raster() -> Raster:
    x, y = np.arange(0.5, 20.0), np.arange(0.5, 20.0)
    return Raster(x, y, -30.0 - 20.0 * np.log10(1.0 + np.hypot(x[None, :], y[:, None])))


def _write_map(path: Path) -> None:
    write_rasters(path, {"path_gain_db": _raster()})


def _write_netcdf_4(path: Path) -> None:
    raster = _raster()
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"y": len(raster.y_m), "x": len(raster.x_m)}
        file.create_variable("y", ("y",), data=raster.y_m)
        file.create_variable("x", ("x",), data=raster.x_m)
        data = {"data": raster.values, "chunks": (7, 7), "compression": "gzip"}
        file.create_variable("path_gain_db", ("y", "x"), **data)


def _write_image(path: Path) -> None:
    shades = np.full((12, 12), 254, dtype=np.uint8)
    shades[2:5, 2:6], shades[7:10, 8] = 0, 0
    Image.fromarray(shades).save(path)


def _short(name: str, max_steps: str) -> str:
    """Return a problem of the library whose runs have three steps, without pictures."""
    text = (library_folder() / f"{name}.toml").read_text()
    assert max_steps in text
    text = text.replace(max_steps, "max_steps = 3") if "=" in max_steps else text
    return f"{text.partition('[report]')[0]}\n[report]\nfigures = false\n"


def _measured() -> list[tuple[float, float, float]]:
    places = [(3.0 + (7 * i) % 40, 2.0 + (11 * i) % 37) for i in range(40)]
    return [
        (x, y, float(-30.0 - 25.0 * np.log10(np.hypot(x, y)) + 4.0 * np.sin(i)))
        for i, (x, y) in enumerate(places)
    ]


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
