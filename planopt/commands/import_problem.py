"""``planopt import``: problem file from a power log and an occupancy map."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from planopt.commands.fit import DEGENERATE, log_format_of, require_option
from planopt.commands.options import (
    FormatOptions,
    JsonOption,
    option,
    progress,
    results_folder,
    show,
    with_options,
)
from planopt.errors import InputError, OutputError

if TYPE_CHECKING:
    from planopt.problems.draft import Draft


@with_options(FormatOptions)
def import_problem(
    options: FormatOptions,
    log: Annotated[Path, option("--log", "FILE", "Power log: CSV or a known program's log.")],
    start: Annotated[
        str, option("--start", "X,Y", "Start of the robot in metres, or LAT,LON with --origin.")
    ],
    goal: Annotated[str, option("--goal", "X,Y", "Goal of the robot, in the same form.")],
    out: Annotated[Path, option("--out", "FILE.toml", "Problem file to write.")],
    map_file: Annotated[
        Path | None,
        option("--map", "FILE", "Occupancy map (.yaml of Nav2, .csv) or obstacles (.geojson)."),
    ] = None,
    transmitter_column: Annotated[
        str | None,
        option("--transmitter-column", "COLUMN", "Column of transmitters; default: detected."),
    ] = None,
    transmitter: Annotated[
        list[str] | None,
        option("--transmitter", "NAME", "Transmitter to use as a station; may be repeated."),
    ] = None,
    station: Annotated[
        list[str] | None,
        option(
            "--station",
            "[NAME=]X,Y[,HEIGHT]",
            "Known position of a transmitter, or LAT,LON[,HEIGHT] if --origin is given. Others "
            "are estimated from the log.",
        ),
    ] = None,
    stations: Annotated[
        Path | None, option("--stations", "FILE", "Table of names and positions of transmitters.")
    ] = None,
    threshold: Annotated[
        float | None,
        option(
            "--threshold",
            "DBM",
            "Minimum power of a connection; default: 10 dB above the weakest reading.",
        ),
    ] = None,
    p_min: Annotated[float, option("--p-min", "P", "Required probability of connection.")] = 0.9,
    speed: Annotated[
        float | None, option("--speed", "M_S", "Speed of the robot; default: 1 m/s.")
    ] = None,
    clearance: Annotated[
        float | None,
        option(
            "--clearance", "M", "Distance of the robot's centre from obstacles; default: 0.3 m."
        ),
    ] = None,
    force: Annotated[bool, option("--force", None, "Replace an existing problem file.")] = False,
    json: JsonOption = False,
) -> int:
    """Make a problem file from a power log and a map.

    Columns, delimiter, units and transmitters are detected, and the positions of transmitters
    are estimated. The output lists every assumption.
    """
    from planopt.files.writing import write_text
    from planopt.problems.draft import DraftSettings, draft_problem
    from planopt.report import draw_draft, save_figure

    if out.suffix != ".toml":
        raise InputError(
            "is not a name for a problem file", file=out, remedy="use a name that ends in .toml"
        )
    if out.exists() and not force:
        raise OutputError(f"{out} already exists (choose another name, or add --force)")
    for value, key in ((speed, "--speed"), (clearance, "--clearance")):
        require_option(
            value is None or (value > 0.0 and math.isfinite(value)), value, key, "give more than 0"
        )
    picture = out.with_suffix(".png")
    with results_folder(out.parent):
        with progress("reading, and locating transmitters"):
            draft = draft_problem(
                log,
                out,
                DraftSettings(
                    start=start,
                    goal=goal,
                    stations=tuple(station or ()),
                    stations_file=stations,
                    transmitters=tuple(transmitter or ()),
                    threshold_dbm=threshold,
                    p_min=p_min,
                    speed_m_s=speed,
                    clearance_m=clearance,
                ),
                map_file=map_file,
                log_format=log_format_of(options),
                transmitter_column=transmitter_column,
            )
        with progress("drawing"):
            save_figure(draw_draft(draft), picture)
        write_text(out, draft.text)
    data = draft_json(draft, out, picture)
    show(json, data, _in_words(data))
    return DEGENERATE if any(each.fit.status == "degenerate" for each in draft.stations) else 0


def draft_json(draft: Draft, file: Path, picture: Path) -> dict[str, Any]:
    """Return the JSON object of ``planopt import``."""
    from planopt.files.tables import finite

    return {
        "problem": str(file),
        "picture": str(picture),
        "stations": [
            {
                "name": each.name,
                "transmitter": each.label,
                "position_m": list(each.fit.parameters.station.position_m),
                "position_std_m": finite(each.position_std_m),
                "located": not each.is_given,
                "measurements": len(each.measurements),
                "censored": int(each.measurements.censored.sum()),
                "status": each.fit.status,
            }
            for each in draft.stations
        ],
        "assumptions": list(draft.assumptions),
        "warnings": list(draft.warnings),
    }


def _in_words(data: dict[str, Any]) -> str:
    lines = [f"{data['problem']}: written; picture: {data['picture']}"]
    for each in data["stations"]:
        x, y = each["position_m"]
        std = each["position_std_m"]
        source = "not determined" if std is None else f"located with standard deviation {std:.2g} m"
        lines.append(
            f"  station {each['name']} at ({x:.1f}, {y:.1f}) m, "
            + (source if each["located"] else "as given")
            + f"; {each['measurements']} power measurements, {each['censored']} of them upper "
            f"limits; channel fit: {each['status']}"
        )
    lines += ["assumptions:", *(f"  {each}" for each in data["assumptions"])]
    if data["warnings"]:
        lines += ["warnings:", *(f"  {each}" for each in data["warnings"])]
    lines.append(f"next: planopt solve {data['problem']} --out plan")
    return "\n".join(lines)
