"""``planopt fit``: channel parameters from a power log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from planopt.commands.log_fit import (
    CensoredOption,
    ColumnsOption,
    FloorOption,
    LogArgument,
    MethodOption,
    StationOption,
    read_and_fit,
)
from planopt.commands.options import JsonOption, OutOption
from planopt.commands.output import progress, results_folder, show, shown_number

if TYPE_CHECKING:
    from planopt.channel.fit import ChannelFit

FIT_FILE = "fit.json"
UNITS = {
    "k_pl_db": "dBm",
    "n_pl": "",
    "shadow_std_db": "dB",
    "decorrelation_m": "m",
    "multipath_std_db": "dB",
}


def fit(
    log: LogArgument,
    station: StationOption,
    method: MethodOption = "reml",
    columns: ColumnsOption = None,
    censored: CensoredOption = None,
    floor: FloorOption = None,
    out: OutOption = None,
    json: JsonOption = False,
) -> int:
    """Fit path loss, shadowing and multipath."""
    with results_folder(out) as folder:
        with progress("fitting"):
            measurements, found = read_and_fit(log, station, method, columns, censored, floor)
        data = fit_json(found)
        if folder is not None:
            from planopt.commands.pictures import picture_fit
            from planopt.files import write_text
            from planopt.planning.solution_json import strict_text

            picture_fit(measurements, found, folder)
            write_text(folder / FIT_FILE, strict_text(data))
    show(json, data, _in_words(data))
    return 0


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
