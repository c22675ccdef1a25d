"""The files that a problem needs for simulation are there."""

from __future__ import annotations

from pathlib import Path

from planopt.errors import InputError
from planopt.problems.channel_setup import LoggedMeasurements, RasterTruth, SampledMeasurements
from planopt.problems.problem import Problem
from planopt.problems.station_sources import log_of, raster_truth_of
from planopt.world.raster_files import raster_ending


def check_files(problem: Problem) -> None:
    """Raise an error for a file that the problem needs for simulation and that is not there.

    Apart from :func:`planopt.problems.checks.check`, because a saved plan can be judged without
    these files.

    Raises
    ------
    InputError
        A station's map or its log of measurements is not a file.
    """
    truth, measurements = problem.channel.truth, problem.channel.measurements
    if isinstance(measurements, SampledMeasurements) and measurements.count == 0:
        raise InputError(
            "is 0, should be greater than or equal to 1",
            file=problem.file,
            key="channel.measurements.count",
            remedy="take some, or give the file of a log",
        )
    for number, radio in enumerate(problem.stations):
        if isinstance(truth, RasterTruth):
            own = radio.gain_file is not None
            key = f"stations[{number}].gain_file" if own else "channel.truth.file"
            _check_map(problem, raster_truth_of(truth, radio).file, key)
        if isinstance(measurements, LoggedMeasurements):
            own = radio.log_file is not None
            key = f"stations[{number}].log_file" if own else "channel.measurements.file"
            _check_file(problem, log_of(measurements, radio).file, key)


def _check_map(problem: Problem, path: Path, key: str) -> None:
    _check_file(problem, path, key)
    try:
        raster_ending(path)
    except InputError as error:
        raise InputError(error.message, file=problem.file, key=key, remedy=error.remedy) from error


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
