"""``planopt fit``: channel parameters from a power log."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from planopt.commands.hold_out import (
    HoldOutOption,
    ThresholdOption,
    held_out,
    held_out_json,
    held_out_reliability_words,
    held_out_words,
    require_hold_out,
)
from planopt.commands.log_fit import (
    CensoredOption,
    ColumnsOption,
    FloorOption,
    ForgettingOption,
    LogArgument,
    LogFit,
    LogOptions,
    LossOption,
    MethodOption,
    OriginOption,
    PositionErrorOption,
    ReceiverOption,
    ResolutionOption,
    StationMethodOption,
    StationOption,
    TimeOption,
    WhereOption,
    read_and_fit,
)
from planopt.commands.options import JsonOption, OutOption
from planopt.commands.output import drawing, progress, results_folder, show, shown_number
from planopt.files.result_folder import ResultFiles

if TYPE_CHECKING:
    from planopt.channel.estimation.channel_fit import ChannelFit

FIT_FILE = "fit.json"
FIT = ResultFiles("fit", (FIT_FILE, "fit.png", "held_out.png", "reliability.png"))
"""The files of a fit with its pictures."""

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
    station_method: StationMethodOption = None,
    columns: ColumnsOption = None,
    censored: CensoredOption = None,
    floor: FloorOption = None,
    resolution: ResolutionOption = 0.0,
    position_error: PositionErrorOption = 0.0,
    time: TimeOption = None,
    forgetting: ForgettingOption = None,
    receiver: ReceiverOption = None,
    where: WhereOption = None,
    origin: OriginOption = None,
    loss: LossOption = "squares",
    hold_out: HoldOutOption = None,
    threshold: ThresholdOption = None,
    out: OutOption = None,
    json: JsonOption = False,
) -> int:
    """Fit path loss, shadowing and multipath."""
    require_hold_out(threshold, hold_out)
    options = LogOptions(
        columns,
        censored,
        floor,
        resolution,
        position_error,
        time,
        forgetting,
        receiver,
        where,
        origin,
    )
    with results_folder(out) as folder:
        with progress("fitting"):
            fitted = read_and_fit(log, station, method, options, loss, station_method)
        data = fit_json(fitted)
        report = None
        if hold_out is not None:
            with progress("predicting what is held out"):
                report = held_out(log, fitted, hold_out, threshold)
            data["held_out"] = held_out_json(report, hold_out)
        if folder is not None:
            from planopt.files.result_folder import replaced_results
            from planopt.files.whole import strict_text, write_text

            with replaced_results(folder, FIT, pictures_follow=True) as new:
                write_text(new / FIT_FILE, strict_text(data))
        # Results come before pictures: whatever happens to these, the numbers are there.
        lines = [_in_words(data), *([] if report is None else held_out_reliability_words(report))]
        show(json, data, "\n".join(lines))
        with drawing(folder, FIT, wanted=True) as new:
            if new is not None:
                from planopt.commands.pictures import picture_fit, picture_held_out

                picture_fit(fitted.measurements, fitted.found, new)
                if report is not None:
                    picture_held_out(report, new)
    return 0


def fit_json(fitted: LogFit) -> dict[str, Any]:
    """Return the JSON keys of ``fit``; standard errors that are unknown are null.

    So is ``forgetting_s`` where the channel does not drift, ``reference_receiver`` where the log
    has no receivers, and an end that an interval does not have. ``intervals_95`` has what is hardly
    or not determined, ``other_modes`` what is nearly as likely.
    """
    from planopt.planning.files.record import finite

    found, receivers = fitted.found, fitted.receivers
    parameters = found.parameters
    return {
        "method": found.method,
        "status": found.status,
        **{name: finite(getattr(parameters, name)) for name in UNITS},
        "station": list(parameters.station.position_m),
        "station_height_m": parameters.station.height_m,
        "station_standard_errors_m": _station_errors_m(found),
        "standard_errors": {name: finite(found.standard_errors[name]) for name in UNITS},
        "intervals_95": {
            name: [finite(low), finite(high)] for name, (low, high) in found.intervals_95.items()
        },
        "other_modes": [
            {
                **{name: getattr(mode.parameters, name) for name in UNITS},
                "log_likelihood": mode.log_likelihood,
            }
            for mode in found.other_modes
        ],
        "measurements": found.measurements,
        "censored": found.censored,
        "log_likelihood": finite(found.log_likelihood),
        "forgetting_s": finite(parameters.forgetting_s),
        "reference_receiver": receivers[0] if receivers else None,
        "receiver_offsets": [
            {
                "receiver": receivers[offset.receiver],
                "offset_db": offset.offset_db,
                "standard_error": offset.standard_error_db,
            }
            for offset in found.receiver_offsets
        ],
        "warnings": list(found.warnings),
    }


def _station_errors_m(found: ChannelFit) -> list[float | None] | None:
    """Of the station's x and y; null where it was given, each null where it is not determined."""
    from planopt.planning.files.record import finite

    covariance = found.station_covariance_m2
    if covariance is None:
        return None
    return [finite(math.sqrt(covariance[axis, axis])) for axis in range(2)]


def _in_words(data: dict[str, Any]) -> str:
    x, y = data["station"]
    lines = [
        f"{data['method']}: {data['status']}, {data['measurements']} measurements, "
        f"{data['censored']} of them upper limits, station ({x:g}, {y:g})"
        f"{_errors_in_words(data['station_standard_errors_m'])}"
    ]
    for name, unit in UNITS.items():
        error = shown_number(data["standard_errors"][name], digits=2)
        lines.append(f"  {name:17}{shown_number(data[name]):>9} +- {error} {unit}".rstrip())
    for offset in data["receiver_offsets"]:
        error = shown_number(offset["standard_error"], digits=2)
        lines.append(
            f"  receiver {offset['receiver']} reads {offset['offset_db']:+.2f} +- {error} dB "
            f"against {data['reference_receiver']}"
        )
    lines += [f"  {warning}" for warning in data["warnings"]]
    if "held_out" in data:
        lines += held_out_words(data["held_out"])
    return "\n".join(lines)


def _errors_in_words(errors_m: list[float | None] | None) -> str:
    """Of an estimated station."""
    if errors_m is None:
        return ""
    x, y = (shown_number(error, digits=2) for error in errors_m)
    return f" +- ({x}, {y}) m"
