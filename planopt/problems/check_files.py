"""The files that a problem needs for simulation are there."""

from __future__ import annotations

from pathlib import Path

from planopt.errors import InputError
from planopt.problems.channel_setup import LoggedMeasurements, RasterTruth
from planopt.problems.problem import Problem
from planopt.world.raster_files import raster_ending


def check_files(problem: Problem) -> None:
    """Raise an error for a file that the problem needs for simulation and that is not there.

    Apart from :func:`planopt.problems.checks.check`, because a saved plan can be judged without
    these files.

    Raises
    ------
    InputError
        The truth's map or the log of measurements is not a file.
    """
    truth, measurements = problem.channel.truth, problem.channel.measurements
    if isinstance(truth, RasterTruth):
        _check_file(problem, truth.file, "channel.truth.file")
        try:
            raster_ending(truth.file)
        except InputError as error:
            raise InputError(
                error.message, file=problem.file, key="channel.truth.file", remedy=error.remedy
            ) from error
    if isinstance(measurements, LoggedMeasurements):
        _check_file(problem, measurements.file, "channel.measurements.file")


def _check_file(problem: Problem, path: Path, key: str) -> None:
    try:
        there = path.is_file()
    except OSError:  # a name that the file system does not allow
        there = False
    if not there:
        raise InputError(
            f"{path} is not a file",
            file=problem.file,
            key=key,
            remedy="file names are relative to the problem file",
        )
