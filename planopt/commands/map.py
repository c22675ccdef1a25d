"""``planopt map``: radio map on a grid, from a power log."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from planopt.commands.fit import fit_json, read_and_fit
from planopt.commands.options import JsonOption, LogOptions, option, with_options
from planopt.commands.output import progress, results_folder, show
from planopt.errors import InputError
from planopt.files.writing import replaced_results

if TYPE_CHECKING:
    from planopt.channel.channel_map import Bounds, PosteriorMap
    from planopt.channel.measurements import Measurements

VARIABLES = ("mean_db", "deviation_db", "connectivity")
"""Variables of a map."""


@with_options(LogOptions)
def map_log(
    options: LogOptions,
    out: Annotated[Path, option("--out", "FILE", "Ends in .csv, .npz, .nc or .tif.")],
    cell: Annotated[
        float | None, option("--cell", "M", "Cell side in metres; default: 200 cells.")
    ] = None,
    bounds: Annotated[
        str | None,
        option("--bounds", "X0,Y0,X1,Y1", "Bounds in metres; default: the measured area."),
    ] = None,
    threshold: Annotated[
        float | None,
        option(
            "--threshold",
            "DBM",
            "Connected from here on; default: --floor, or the least power of the log.",
        ),
    ] = None,
    picture: Annotated[
        Path | None, option("--picture", "FILE", "Draw it too; .png, .svg or .pdf.")
    ] = None,
    json: JsonOption = False,
) -> int:
    """Write a radio map of a log: power, its standard deviation, probability of connection.

    The map is for the first receiver in the log, at the time of the latest measurement.
    """
    from planopt.channel.channel_map import default_cell_m, measured_bounds_m, posterior_map
    from planopt.channel.cholesky import one_blas_thread
    from planopt.channel.posterior import condition
    from planopt.world.raster_files import check_raster_output, write_rasters

    check_raster_output(out)
    box = None if bounds is None else parse_bounds(bounds)
    with _writable(out, picture):
        with progress("mapping"), one_blas_thread():
            fitted = read_and_fit(options)
            measurements, found = fitted.measurements, fitted.found
            box = measured_bounds_m(measurements) if box is None else box
            maps = posterior_map(
                condition(found.parameters, measurements),
                box,
                default_cell_m(box) if cell is None else cell,
                _threshold_dbm(threshold, options.floor, measurements),
            )
        with _together(out, picture) as (new_out, new_picture):
            write_rasters(new_out, {name: getattr(maps, name) for name in VARIABLES})
            if new_picture is not None:
                from planopt.report import draw_posterior_map, save_figure

                title = f"{options.log.name}: {len(measurements)} measurements, {found.method} fit"
                with progress("drawing"):
                    station = found.parameters.station
                    figure = draw_posterior_map(maps, measurements, station, title)
                    save_figure(figure, new_picture)
    data = {**map_json(maps, out, picture), "fit": fit_json(fitted)}
    show(json, data, _in_words(data))
    return fitted.exit_code


def parse_bounds(text: str) -> Bounds:
    """Parse ``X0,Y0,X1,Y1`` in metres."""
    try:
        x_min, y_min, x_max, y_max = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"cannot read {text!r}", key="--bounds", remedy="write X0,Y0,X1,Y1 in metres"
        ) from None
    return x_min, y_min, x_max, y_max


def map_json(maps: PosteriorMap, out: Path, picture: Path | None) -> dict[str, Any]:
    """Return the JSON object of ``planopt map`` that describes the map."""
    raster = maps.mean_db
    return {
        "file": str(out),
        "picture": None if picture is None else str(picture),
        "variables": list(VARIABLES),
        "shape": list(raster.values.shape),
        "cell_m": raster.cell_m[0],
        "x_m": [float(raster.x_m[0]), float(raster.x_m[-1])],
        "y_m": [float(raster.y_m[0]), float(raster.y_m[-1])],
        "threshold_dbm": maps.threshold_dbm,
        "connected_share": float((maps.connectivity.values >= 0.5).mean()),
        "posterior": maps.posterior,
    }


def _threshold_dbm(
    threshold: float | None, floor: float | None, measurements: Measurements
) -> float:
    """Return the required threshold, by default the weakest power in the log."""
    if threshold is not None:
        return threshold
    return float(measurements.power_dbm.min()) if floor is None else floor


@contextlib.contextmanager
def _writable(out: Path, picture: Path | None) -> Generator[None]:
    """Check that both files are writable before any computation."""
    with contextlib.ExitStack() as stack:
        for file in (out, picture):
            if file is not None:
                stack.enter_context(results_folder(file.parent))
        yield


@contextlib.contextmanager
def _together(out: Path, picture: Path | None) -> Generator[tuple[Path, Path | None]]:
    """Yield temporary names of map and figure; on exit, move both into place."""
    files = [file for file in (out, picture) if file is not None]
    with contextlib.ExitStack() as stack:
        staged: dict[Path, Path] = {}
        for folder in dict.fromkeys(file.parent for file in files):
            names = tuple(escape(file.name) for file in files if file.parent == folder)
            staged[folder] = stack.enter_context(replaced_results(folder, names))
        yield (
            staged[out.parent] / out.name,
            None if picture is None else staged[picture.parent] / picture.name,
        )


def _in_words(data: dict[str, Any]) -> str:
    rows, columns = data["shape"]
    (x_min, x_max), (y_min, y_max) = data["x_m"], data["y_m"]
    fit = data["fit"]
    lines = [
        f"{data['file']}: {rows} x {columns} cells of {data['cell_m']:g} m, "
        f"x {x_min:g} to {x_max:g}, y {y_min:g} to {y_max:g}",
        f"  from {fit['measurements']} measurements, {fit['censored']} of them upper limits "
        f"({fit['method']}: {fit['status']}; {data['posterior']})",
        f"  {100.0 * data['connected_share']:.1f} % of the cells have P(power at least "
        f"{data['threshold_dbm']:g} dBm) of 0.5 or more",
        *(f"  {warning}" for warning in fit["warnings"]),
    ]
    if data["picture"] is not None:
        lines.append(f"  picture: {data['picture']}")
    return "\n".join(lines)
