"""``planopt fit --hold-out``: whole walks predicted from the others, against plain predictors."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from planopt.errors import InputError

if TYPE_CHECKING:
    from planopt.channel.validation.held_out import GroupedRatio
    from planopt.channel.validation.held_out_report import HeldOutReport, HeldOutScore
    from planopt.commands.log_fit import LogFit

HoldOutOption = Annotated[
    str | None,
    typer.Option(
        "--hold-out",
        metavar="COLUMN[:BLOCK][,...]",
        help="Predict rows that agree in these columns from all others, such as day or "
        "day,t_s:600 (blocks of 600 in t_s).",
    ),
]

ThresholdOption = Annotated[
    float | None,
    typer.Option(
        "--threshold",
        metavar="DBM",
        help="With --hold-out: at least this power is a connection (the median power).",
    ),
]

MOST_FOLDS = 10
"""The fit is repeated without each group in turn, or without each of so many shares of them."""

SEED = 0
"""Of which group goes to which share."""

NAME_WIDTH = 13
"""Of the names of what predicted."""

SHOWN_LEVELS = (0.5, 0.8, 0.95)
"""Coverage for people; JSON has all levels."""


def require_hold_out(threshold_dbm: float | None, text: str | None) -> None:
    """Raise an InputError where a threshold is no power, or nothing is held out to use it for."""
    if threshold_dbm is None:
        return
    if not math.isfinite(threshold_dbm):
        raise InputError(f"{threshold_dbm!r} cannot be used", key="--threshold", remedy="give dBm")
    if text is None:
        raise InputError(
            "is for what is held out", key="--threshold", remedy="give --hold-out COLUMN as well"
        )


def held_out(
    log: Path, fitted: LogFit, text: str, threshold_dbm: float | None = None
) -> HeldOutReport:
    """Hold out what `text` says, fit the rest as the whole was fitted, and score.

    At least `threshold_dbm` counts as connected; None for the median power.

    Raises
    ------
    InputError
        `text` or the columns cannot be used, there is one group only, several receivers measured,
        or without some groups there is nothing to fit.
    """
    import numpy as np

    from planopt.channel.logs.log_groups import parse_groups, read_groups
    from planopt.channel.validation.held_out import deal
    from planopt.channel.validation.held_out_report import held_out_report, predictors_of

    groups = read_groups(log, parse_groups(text), fitted.log_format)
    count = len(np.unique(groups))
    if count < 2:
        raise InputError(
            f"all rows agree in {text}",
            file=log,
            key="--hold-out",
            remedy="name columns, or a block, that tell walks apart",
        )
    if fitted.measurements.receiver.any():
        raise InputError(
            "path loss alone, which others are compared with, knows no offsets of receivers",
            key="--hold-out",
            remedy="hold out without --receiver, on the log of one receiver",
        )
    fold_of = deal(groups, min(count, MOST_FOLDS), np.random.default_rng(SEED))
    try:
        return held_out_report(
            fitted.measurements, groups, fold_of, predictors_of(fitted.fit), threshold_dbm
        )
    except InputError as error:
        # Its row, if any, is one of a part of the log.
        raise InputError(
            f"without some of the groups: {error.message}",
            file=log,
            key="--hold-out",
            remedy=error.remedy,
        ) from None


def held_out_json(report: HeldOutReport, text: str) -> dict[str, Any]:
    """What ``held_out`` of the JSON has."""
    return {
        "columns": text,
        "groups": report.groups,
        "folds": len(report.fold_sizes),
        "fold_sizes": list(report.fold_sizes),
        "measurements": report.measurements,
        "censored": report.censored,
        "threshold_dbm": report.threshold_dbm,
        "predictors": {name: _score_json(score) for name, score in report.scores.items()},
    }


def held_out_words(data: dict[str, Any]) -> list[str]:
    """Lines for people, from what :func:`held_out_json` gives."""
    header = f"  {'':{NAME_WIDTH}}  {'RMSE [dB]':22}  {'of path loss':22}" + "".join(
        f"  {f'inside {level:.0%}':21}" for level in SHOWN_LEVELS
    )
    lines = [
        f"held out by {data['columns']}: {data['groups']} groups in {data['folds']} folds, "
        "intervals over the groups",
        header.rstrip(),
    ]
    for name, score in data["predictors"].items():
        inside = {one["level"]: one for one in score["coverage"]}
        cells = [
            f"{name:{NAME_WIDTH}}",
            f"{_words(score['rmse_db'], '.2f'):22}",
            f"{_words(score['of_path_loss'], '.3f'):22}",
            *(f"{_words(inside[level], '.1%'):21}" for level in SHOWN_LEVELS),
        ]
        lines.append("  " + "  ".join(cells).rstrip())
    return lines


def held_out_reliability_words(report: HeldOutReport) -> list[str]:
    """Lines for people: predicted against true connection, as the channel predicts it."""
    from planopt.report.tables import reliability_lines

    return [
        f"P(power at least {report.threshold_dbm:g} dBm), predicted by the channel:",
        *(
            f"  {line}"
            for line in reliability_lines(report.scores["channel"].reliability, "powers", "groups")
        ),
    ]


def _score_json(score: HeldOutScore) -> dict[str, Any]:
    from planopt.planning.files.run_json import reliability_json

    return {
        "rmse_db": _ratio_json(score.rmse_db),
        "of_path_loss": _ratio_json(score.of_path_loss),
        "coverage": [
            {"level": level, **_ratio_json(ratio)} for level, ratio in score.coverage.items()
        ],
        "reliability": reliability_json(score.reliability),
    }


def _ratio_json(ratio: GroupedRatio) -> dict[str, float]:
    return {"value": ratio.value, "low": ratio.low, "high": ratio.high}


def _words(ratio: dict[str, float], form: str) -> str:
    """The number with its interval."""
    low, high = format(ratio["low"], form).rstrip("%"), format(ratio["high"], form)
    return f"{ratio['value']:{form}} ({low} to {high})"
