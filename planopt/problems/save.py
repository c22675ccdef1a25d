"""A problem in full as plain data, in the tables and keys of a problem file, and back.

Saved plans and runs contain it, so that they can be verified from their own files: obstacles are
polygons at full precision. The map of the ground truth and a log of measurements, which the
verification does not need, are named by their absolute path.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from planopt.errors import InputError
from planopt.problems.channel_setup import (
    ArrayTruth,
    ChannelSetup,
    FunctionTruth,
    LoggedMeasurements,
    SampledMeasurements,
)
from planopt.problems.objective import ReachObjective, TermsObjective, term_keys
from planopt.problems.problem import Problem, problem_from_tables, tables_of
from planopt.problems.robot import Robot
from planopt.problems.tables import saved
from planopt.problems.world_tables import world_table
from planopt.world.workspace import Workspace


def problem_to_dict(problem: Problem) -> dict[str, Any]:
    """`problem` as JSON-serialisable tables; :func:`problem_from_dict` reads them.

    Keys that have no value are left out, as they are in a problem file.
    """
    return {key: saved_table(part) for key, part in tables_of(problem).items()}


def saved_table(part: Any) -> Any:
    """Return a part of a problem as its table, or several of them as an array of tables."""
    match part:
        case Workspace():
            return world_table(part)
        case ChannelSetup():
            return saved(_without_python(part))
        case ReachObjective():
            return saved(part)
        case TermsObjective():
            return {"terms": [term_keys(term) for term in part.terms]}
        case Robot(dynamics=dynamics) if not (part.moves_freely or "dynamics" in part.to_keys()):
            raise InputError(
                f"{dynamics.kind} is from Python and cannot be saved",
                key="robots.dynamics",
                remedy="use the plans and runs in Python",
            )
        case tuple():
            return [saved_table(each) for each in cast("tuple[Any, ...]", part)]
        case _:
            return saved(part)


def problem_from_dict(data: Mapping[str, Any], *, file: Path | None = None) -> Problem:
    """The problem that :func:`problem_to_dict` wrote, validated as a problem file is.

    Parameters
    ----------
    data
        The tables, for instance from ``json.load``.
    file
        Where they came from, for messages; relative file names in them start at its folder.

    Raises
    ------
    InputError
        As for a problem file, except that the truth's map and the log need not be there.
    """
    folder = Path.cwd() if file is None else file.absolute().parent
    return problem_from_tables(data, folder=folder, file=file)


def _without_python(channel: ChannelSetup) -> ChannelSetup:
    """Return the channel without a truth from Python, nor measurements to be taken from it."""
    if not isinstance(channel.truth, ArrayTruth | FunctionTruth):
        return channel
    logged = isinstance(channel.measurements, LoggedMeasurements)
    left = channel.measurements if logged else SampledMeasurements()
    return replace(channel, truth=None, measurements=left)
