"""``planopt fit``: channel parameters from a power log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast, get_args

import typer

from planopt.commands.options import JsonOption, OutOption
from planopt.commands.output import progress, results_folder, show, shown_number
from planopt.errors import InputError

if TYPE_CHECKING:
    from planopt.channel.fit import ChannelFit, FitMethod
    from planopt.channel.measurements import Measurements
    from planopt.channel.parameters import Station

FIT_FILE = "fit.json"
UNITS = {
    "k_pl_db": "dBm",
    "n_pl": "",
    "shadow_std_db": "dB",
    "decorrelation_m": "m",
    "multipath_std_db": "dB",
}


def fit(
    log: Annotated[Path, typer.Argument(metavar="LOG.csv", help="A CSV file with a header.")],
    station: Annotated[
        str, typer.Option("--station", metavar="X,Y[,HEIGHT]|unknown", help="In metres.")
    ],
    method: Annotated[
        str, typer.Option("--method", metavar="NAME", help="seed, capped, convex, nls or reml.")
    ] = "reml",
    columns: Annotated[
        str | None,
        typer.Option("--columns", metavar="x=NAME,y=NAME,power=NAME", help="Names of columns."),
    ] = None,
    censored: Annotated[
        str | None,
        typer.Option("--censored", metavar="COLUMN", help="1 where power is an upper limit."),
    ] = None,
    floor: Annotated[
        float | None,
        typer.Option("--floor", metavar="DBM", help="Powers at or below are upper limits."),
    ] = None,
    out: OutOption = None,
    json: JsonOption = False,
) -> int:
    """Fit path loss, shadowing and multipath."""
    from planopt.channel.fit import FitMethod
    from planopt.channel.log_file import DEFAULT_COLUMNS, parse_columns, parse_station, read_log

    if method not in get_args(FitMethod):
        raise InputError(
            f"{method!r} is no method",
            key="--method",
            remedy=f"use {', '.join(get_args(FitMethod))}",
        )
    site = parse_station(station)
    names = DEFAULT_COLUMNS if columns is None else parse_columns(columns)
    measurements = read_log(log, names, censored, floor)
    with results_folder(out) as folder:
        with progress("fitting"):
            found = _fitted(log, measurements, site, cast("FitMethod", method))
        data = fit_json(found)
        if folder is not None:
            from planopt.commands.pictures import picture_fit
            from planopt.files import write_text
            from planopt.planning.solution_json import strict_text

            picture_fit(measurements, found, folder)
            write_text(folder / FIT_FILE, strict_text(data))
    show(json, data, _in_words(data))
    return 0


def _fitted(
    log: Path, measurements: Measurements, station: Station | None, method: FitMethod
) -> ChannelFit:
    """The fit; errors name the line of the log."""
    from planopt.channel.fit import fit_channel
    from planopt.channel.log_file import at_file_line
    from planopt.channel.station_search import fit_channel_and_station

    try:
        if station is None:
            return fit_channel_and_station(measurements, method)
        return fit_channel(measurements, station, method)
    except InputError as error:
        raise at_file_line(error, log) from None


def fit_json(found: ChannelFit) -> dict[str, Any]:
    """The JSON keys of ``fit`` (design, section 3); standard errors that are unknown are null."""
    from planopt.planning.solution_json import finite

    parameters = found.parameters
    return {
        "method": found.method,
        "status": found.status,
        **{name: finite(getattr(parameters, name)) for name in UNITS},
        "station": list(parameters.station.position_m),
        "station_height_m": parameters.station.height_m,
        "standard_errors": {name: finite(found.standard_errors[name]) for name in UNITS},
        "measurements": found.measurements,
        "censored": found.censored,
        "log_likelihood": finite(found.log_likelihood),
        "warnings": list(found.warnings),
    }


def _in_words(data: dict[str, Any]) -> str:
    x, y = data["station"]
    lines = [
        f"{data['method']}: {data['status']}, {data['measurements']} measurements, "
        f"{data['censored']} of them upper limits, station ({x:g}, {y:g})"
    ]
    for name, unit in UNITS.items():
        error = shown_number(data["standard_errors"][name], digits=2)
        lines.append(f"  {name:17}{shown_number(data[name]):>9} +- {error} {unit}".rstrip())
    return "\n".join([*lines, *(f"  {warning}" for warning in data["warnings"])])
