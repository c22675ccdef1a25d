"""``planopt fit``: channel parameters estimated from a power log.

``planopt fit --hold-out``: cross-validation by walk, compared with simple baseline predictors.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast, get_args

from planopt.commands.options import (
    FormatOptions,
    JsonOption,
    LogOptions,
    OutOption,
    drawing,
    option,
    progress,
    results_folder,
    show,
    with_options,
)
from planopt.errors import InputError, listed

if TYPE_CHECKING:
    from planopt.channel.calibration import GroupedRatio
    from planopt.channel.estimation.channel_fit import ChannelFit, Loss
    from planopt.channel.estimation.station_fit import StationMethod
    from planopt.channel.held_out import HeldOutReport, HeldOutScore
    from planopt.channel.logs.log_format import LogFormat
    from planopt.channel.measurements import Measurements
    from planopt.channel.parameters import Station

DEGENERATE = 3  # Exit code if the log does not determine the channel


@dataclass(frozen=True)
class LogFit:
    """Power log with its fitted channel."""

    measurements: Measurements
    found: ChannelFit
    receivers: tuple[str, ...]  # Receiver labels by number; empty without --receiver
    fit: Callable[[Measurements], ChannelFit]  # Fits other measurements with the same options
    log_format: LogFormat
    warnings: tuple[str, ...]  # From the fit, and about implausible values

    @property
    def exit_code(self) -> int:
        """Return 0, or `DEGENERATE` if the log does not determine the channel."""
        return DEGENERATE if self.found.status == "degenerate" else 0


def fit_each(options: LogOptions) -> tuple[dict[str, LogFit], dict[str, int]]:
    """Return each transmitter's fit, and the number of readings if these are too few to fit.

    Without --each, the log belongs to one transmitter with the label "".
    """
    from planopt.channel.logs.log_format import parse_station
    from planopt.channel.logs.power_log import FEWEST_READINGS, transmitters_of
    from planopt.channel.logs.readers import read_stations

    if options.each is None and options.stations is not None:
        remedy = "give --each COLUMN as well, or --station X,Y"
        raise InputError("needs --each", key="--stations", remedy=remedy)
    if options.each is None and options.station is None:
        raise InputError(
            "is missing", key="--station", remedy="give X,Y in metres, or unknown to locate it"
        )
    log_format = log_format_of(options)
    common = parse_station(options.station or "unknown", log_format.origin_deg)
    if options.each is None:
        return {"": _read_and_fit(options, log_format, common)}, {}
    counts = transmitters_of(options.log, options.each, log_format)
    used = [label for label, count in counts.items() if count >= FEWEST_READINGS]
    if not used:
        raise InputError(
            f"no transmitter in column {options.each} has {FEWEST_READINGS} readings",
            file=options.log,
            key="--each",
            remedy="name another column, or give a longer log",
        )
    known: dict[str, Station | None] = {}
    if options.stations is not None:
        known |= read_stations(options.stations, used, log_format.origin_deg)
    if options.station is None and not known.keys() >= set(used):
        raise InputError(
            "is missing",
            key="--station",
            remedy="give unknown to locate transmitters, or their positions with --stations FILE",
        )
    fits: dict[str, LogFit] = {}
    for label in used:
        own = replace(log_format, where=(*log_format.where, (options.each, label)))
        fits[label] = _read_and_fit(options, own, known.get(label, common))
    return fits, {label: count for label, count in counts.items() if label not in fits}


def _read_and_fit(options: LogOptions, log_format: LogFormat, site: Station | None) -> LogFit:
    """Read the log of a transmitter and fit the channel; without `site`, locate the transmitter."""
    from planopt.channel.estimation.channel_fit import require_loss, require_method
    from planopt.channel.estimation.fit import fit_channel
    from planopt.channel.estimation.station_fit import fit_channel_and_station
    from planopt.channel.logs.power_log import at_file_line, read_power_log
    from planopt.problems.plausibility import log_warnings

    chosen = require_method(options.method, "--method")
    require_loss(options.loss, chosen, "--loss")
    loss = cast("Loss", options.loss)
    search = _station_method(options.station_method, station_is_given=site is not None)
    forgetting_s = math.inf if options.forgetting is None else options.forgetting
    require_option(forgetting_s > 0.0, forgetting_s, "--forgetting", "give more than 0 seconds")
    if options.forgetting is not None and options.time is None:
        raise InputError(
            "needs the time of each measurement",
            key="--forgetting",
            remedy="name the column of times by --time COLUMN",
        )
    read = read_power_log(options.log, log_format)
    warnings = tuple(log_warnings(read))

    def fit(measurements: Measurements) -> ChannelFit:
        if site is not None:
            return fit_channel(measurements, site, chosen, forgetting_s, loss=loss)
        return fit_channel_and_station(
            measurements, chosen, None, forgetting_s, station_method=search, loss=loss
        )

    try:
        found = fit(read.measurements)
    except InputError as error:
        remedy = "; ".join(filter(None, (*warnings, error.remedy))) or None
        error = InputError(error.message, key=error.key, row=error.row, remedy=remedy)
        raise at_file_line(error, options.log, log_format) from None
    warnings = (*warnings, *found.warnings)
    return LogFit(read.measurements, found, read.receivers, fit, log_format, warnings)


def _station_method(name: str | None, *, station_is_given: bool) -> StationMethod:
    """Return the method for locating the station."""
    from planopt.channel.estimation.station_fit import StationMethod

    names = get_args(StationMethod)
    if name is None:
        return "joint"
    require_option(name in names, name, "--station-method", f"use {', '.join(names)}")
    if station_is_given:
        raise InputError(
            "is only for an unknown station, but --station gives its position",
            key="--station-method",
            remedy="leave it out, or give --station unknown",
        )
    return cast("StationMethod", name)


OPTIONS = {
    "censored_column": "censored",
    "floor_dbm": "floor",
    "time_column": "time",
    "receiver_column": "receiver",
    "resolution_db": "resolution",
    "position_std_m": "position_error",
    "accuracy_column": "accuracy",
    "power_unit": "power_unit",
    "reader": "reader",
}
"""Option that sets each field of a log format, for fields that need no parsing."""


def log_format_of(options: FormatOptions) -> LogFormat:
    """Return the format of the log that the options describe."""
    from planopt.channel.logs.log_format import LogFormat, parse_columns, parse_where
    from planopt.world.geodesy import parse_origin

    values = {field: getattr(options, name) for field, name in OPTIONS.items()}
    parsed: dict[str, Any] = {"where": parse_where(options.where or ())}
    if options.columns is not None:
        parsed["columns"] = parse_columns(options.columns)
    if options.origin is not None:
        parsed["origin_deg"] = parse_origin(options.origin)
    try:
        return LogFormat(**values, **parsed)
    except InputError as error:
        field = (error.key or "").rpartition(".")[2]
        key = f"--{OPTIONS.get(field, field).replace('_', '-')}"
        raise InputError(error.message, key=key, remedy=error.remedy) from None


def require_option(is_allowed: bool, value: object, key: str, remedy: str) -> None:
    """Raise an error if the value of an option is not allowed."""
    if not is_allowed:
        raise InputError(f"is {value!r}, which is not allowed", key=key, remedy=remedy)


HoldOutOption = Annotated[
    str | None,
    option(
        "--hold-out",
        "COLUMN[:BLOCK][,...]",
        "Cross-validate: rows with equal values of these columns form a group, which is "
        "predicted from the other groups. Examples: day; day,t_s:600 (blocks of 600 in t_s).",
    ),
]

ThresholdOption = Annotated[
    float | None,
    option(
        "--threshold",
        "DBM",
        "With --hold-out: minimum power of a connection; default: the median power.",
    ),
]

MOST_FOLDS = 10  # Maximum number of folds; each fold holds out one or more groups
SEED = 0  # Random seed of the assignment of groups to folds
NAME_WIDTH = 13  # Width of the column of predictor names

PREDICTOR_WORDS = {
    "channel": "the fitted channel, given the powers of the other groups",
    "marginal": "the same, with uncertain covariance parameters",
    "path_loss": "path loss alone",
    "plain_line": "path loss line through the powers above the receiver floor",
    "plain_process": "Gaussian process of the powers above the receiver floor",
}
"""Meaning of each predictor in text."""

SHOWN_LEVELS = (0.5, 0.8, 0.95)
"""Levels of the intervals whose coverage is printed; JSON has all levels."""


def held_out(log: Path, fitted: LogFit, text: str, threshold_dbm: float | None) -> HeldOutReport:
    """Predict each group (by the columns in `text`) from all others, and score the predictions.

    Powers of at least `threshold_dbm` count as connected; None selects the median power.
    """
    import numpy as np

    from planopt.channel.held_out import deal, held_out_report, predictors_of
    from planopt.channel.logs.log_format import parse_groups
    from planopt.channel.logs.power_log import read_groups

    groups = read_groups(log, parse_groups(text), fitted.log_format)
    count = len(np.unique(groups))
    if count < 2:
        raise InputError(
            f"all rows belong to one group: they have the same value of {text}",
            file=log,
            key="--hold-out",
            remedy="name columns whose values differ between measurement runs, or divide a column "
            "into blocks, such as t_s:600",
        )
    if fitted.measurements.receiver.any():
        raise InputError(
            "cannot be combined with --receiver: the baseline predictors have no receiver offsets",
            key="--hold-out",
            remedy="leave --receiver out, and select one receiver with --where",
        )
    fold_of = deal(groups, min(count, MOST_FOLDS), np.random.default_rng(SEED))
    try:
        return held_out_report(
            fitted.measurements, groups, fold_of, predictors_of(fitted.fit), threshold_dbm
        )
    except InputError as error:
        # A row number would refer to a subset of the log.
        raise InputError(
            f"the fit without the held-out groups failed: {error.message}",
            file=log,
            key="--hold-out",
            remedy=error.remedy,
        ) from None


def held_out_json(report: HeldOutReport, text: str) -> dict[str, Any]:
    """Return the value of ``held_out`` in the JSON object."""
    return {
        "columns": text,
        "groups": report.groups,
        "folds": len(report.fold_sizes),
        "fold_sizes": list(report.fold_sizes),
        "measurements": report.measurements,
        "censored": report.censored,
        "threshold_dbm": report.threshold_dbm,
        "predictors": {
            name: _score_json(score, report.groups) for name, score in report.scores.items()
        },
    }


def held_out_words(data: dict[str, Any]) -> list[str]:
    """Return the scores of :func:`held_out_json` as lines of text."""
    from planopt.channel.calibration import FEWEST_GROUPS

    header = (
        f"  {'predictor':{NAME_WIDTH}}  {'RMSE [dB]':22}  {'RMSE / path_loss RMSE':22}"
        + "".join(f"  {f'powers in {100.0 * level:.0f} % interval':22}" for level in SHOWN_LEVELS)
    )
    lines = [
        f"cross-validation by {data['columns']}: {data['groups']} groups in {data['folds']} folds, "
        + (
            "95 % intervals over the groups in brackets"
            if data["groups"] >= FEWEST_GROUPS
            else f"no intervals for fewer than {FEWEST_GROUPS} groups"
        ),
        header.rstrip(),
    ]
    for name, score in data["predictors"].items():
        inside = {one["level"]: one for one in score["coverage"]}
        cells = [
            f"{name:{NAME_WIDTH}}",
            f"{_words(score['rmse_db'], '.2f'):22}",
            f"{_words(score['of_path_loss'], '.3f'):22}",
            *(f"{_words(inside[level], '.1%'):22}" for level in SHOWN_LEVELS),
        ]
        lines.append("  " + "  ".join(cells).rstrip())
    return lines + [f"  {name}: {words}" for name, words in PREDICTOR_WORDS.items()]


def _score_json(score: HeldOutScore, groups: int) -> dict[str, Any]:
    from planopt.planning.files.result_json import reliability_json

    return {
        "rmse_db": _ratio_json(score.rmse_db, groups),
        "of_path_loss": _ratio_json(score.of_path_loss, groups),
        "coverage": [
            {"level": level, **_ratio_json(ratio, groups)}
            for level, ratio in score.coverage.items()
        ],
        "reliability": reliability_json(score.reliability),
    }


def _ratio_json(ratio: GroupedRatio, groups: int) -> dict[str, float | None]:
    from planopt.channel.calibration import FEWEST_GROUPS

    ends = (ratio.low, ratio.high) if groups >= FEWEST_GROUPS else (None, None)
    return {"value": ratio.value, "low": ends[0], "high": ends[1]}


def _words(ratio: dict[str, Any], form: str) -> str:
    """Return a number as text, with its interval if it has one."""
    if ratio["low"] is None:
        return format(ratio["value"], form)
    low, high = format(ratio["low"], form).rstrip("%"), format(ratio["high"], form)
    return f"{ratio['value']:{form}} ({low} to {high})"


FIT_FILE = "fit.json"
FIT = (FIT_FILE, "fit.png", "fit_*.png", "held_out.png", "reliability.png")
"""Files of a fit, including figures."""
STATUS_WORDS = {
    "ok": "the log determines all parameters",
    "weak": "a parameter is poorly determined or implausible",
    "degenerate": "the log does not determine every parameter",
}
"""Meaning of the status of a fit."""

METHOD_WORDS = {
    "map": "maximum a posteriori",
    "reml": "restricted maximum likelihood",
    "lemma1": "Lemma 1 of [GM11] (line through logarithms of the empirical covariance)",
    "capped": "Lemma 1 of [GM11] with a maximum lag and weights",
    "convex": "Lemma 1 of [GM11] as a convex programme",
    "nls": "nonlinear least squares on the empirical covariance",
}
"""Name of each estimator in text."""


@with_options(LogOptions)
def fit(
    options: LogOptions,
    hold_out: HoldOutOption = None,
    threshold: ThresholdOption = None,
    out: OutOption = None,
    json: JsonOption = False,
) -> int:
    """Fit path loss, shadowing and multipath."""
    if threshold is not None:
        require_option(math.isfinite(threshold), threshold, "--threshold", "give dBm")
        if hold_out is None:
            remedy = "add --hold-out COLUMN"
            raise InputError("needs --hold-out", key="--threshold", remedy=remedy)
    if options.each is not None and hold_out is not None:
        remedy = "select one transmitter by --where COLUMN=VALUE"
        raise InputError("cannot be combined with --each", key="--hold-out", remedy=remedy)
    report = None
    with results_folder(out) as folder:
        with progress("fitting"):
            fits, left_out = fit_each(options)
        found = {label: fit_json(each) for label, each in fits.items()}
        if options.each is None:
            data = found[""]
        else:
            data = {"each": options.each, "fits": found, "left_out": left_out}
        if hold_out is not None:
            with progress("predicting what is held out"):
                report = held_out(options.log, fits[""], hold_out, threshold)
            data["held_out"] = held_out_json(report, hold_out)
        if folder is not None:
            from planopt.files.writing import replaced_results, strict_text, write_text

            with replaced_results(folder, FIT) as new:
                write_text(new / FIT_FILE, strict_text(data))
        # The numbers are printed before any figure can fail.
        lines = [f"{label}: {_in_words(each)}".removeprefix(": ") for label, each in found.items()]
        if left_out:
            lines.append(f"left out, with too few measurements: {listed(left_out)}")
        if report is not None:
            from planopt.report import reliability_lines

            lines.append(
                f"P(connected) = P(power >= {report.threshold_dbm:g} dBm) by the predictor channel:"
            )
            bins = report.scores["channel"].reliability
            lines += [f"  {line}" for line in reliability_lines(bins, "powers", "groups")]
        show(json, data, "\n".join(lines))
        with drawing(folder, FIT, wanted=True) as new:
            if new is not None:
                from planopt.report import draw_fit, save_figure

                for number, (label, each) in enumerate(fits.items(), start=1):
                    name = re.sub(r"[^A-Za-z0-9_-]+", "-", label)[:40]
                    figure = draw_fit(each.measurements, each.found, each.found.parameters.station)
                    file = "fit.png" if options.each is None else f"fit_{number}_{name}.png"
                    save_figure(figure, new / file)
                if report is not None:
                    from planopt.report import draw_calibration, draw_reliability

                    scores = {name.replace("_", " "): s for name, s in report.scores.items()}
                    save_figure(draw_calibration(scores), new / "held_out.png")
                    bins = {name: score.reliability for name, score in scores.items()}
                    title = f"P(power at least {report.threshold_dbm:g} dBm), held out"
                    save_figure(draw_reliability(bins, title), new / "reliability.png")
    return max(each.exit_code for each in fits.values())


def fit_json(fitted: LogFit) -> dict[str, Any]:
    """Return the JSON object of ``fit``; ``other_modes`` has other likely parameters."""
    import numpy as np

    from planopt.channel.parameters import PARAMETER_WORDS
    from planopt.files.tables import finite

    found, receivers = fitted.found, fitted.receivers
    parameters = found.parameters
    return {
        "method": found.method,
        "status": found.status,
        **{name: finite(getattr(parameters, name)) for name in PARAMETER_WORDS},
        "station": list(parameters.station.position_m),
        "station_height_m": parameters.station.height_m,
        "station_standard_errors_m": (
            None
            if found.station_covariance_m2 is None
            else [finite(math.sqrt(each)) for each in np.diag(found.station_covariance_m2)]
        ),
        "standard_errors": {name: finite(found.standard_errors[name]) for name in PARAMETER_WORDS},
        "other_modes": [
            {
                **{name: getattr(mode.parameters, name) for name in PARAMETER_WORDS},
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
        "warnings": list(fitted.warnings),
    }


def _in_words(data: dict[str, Any]) -> str:
    from planopt.channel.parameters import PARAMETER_WORDS
    from planopt.short_repr import shown_number

    (x, y), errors_m = data["station"], data["station_standard_errors_m"]
    within = " m"
    if errors_m is not None:
        is_known = None not in errors_m
        within = " +- ({:.2g}, {:.2g}) m".format(*errors_m) if is_known else " m, not determined"
    lines = [
        f"channel fit by {METHOD_WORDS.get(data['method'], data['method'])}: {data['status']} "
        f"({STATUS_WORDS[data['status']]})",
        f"  {data['measurements']} power measurements, {data['censored']} of them upper "
        "limits; estimates +- standard errors:",
        f"  station at ({x:g}, {y:g}){within}",
    ]
    for name, (words, unit) in PARAMETER_WORDS.items():
        error = data["standard_errors"][name]
        error = f" {unit}, not determined" if error is None else f" +- {error:.2g} {unit}"
        value = f"{shown_number(data[name]):>9}{error}"
        lines.append(f"  {name:17}{value:28} {words}")
    for offset in data["receiver_offsets"]:
        error = shown_number(offset["standard_error"], digits=2)
        lines.append(
            f"  receiver {offset['receiver']} reads {offset['offset_db']:+.2f} +- {error} dB "
            f"relative to {data['reference_receiver']}"
        )
    lines += [f"  {warning}" for warning in data["warnings"]]
    if "held_out" in data:
        lines += held_out_words(data["held_out"])
    return "\n".join(lines)
