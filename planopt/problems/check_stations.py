"""Several stations: each has a channel of its own, and what is asked can be computed of them."""

from __future__ import annotations

from collections.abc import Sequence

from planopt.errors import InputError
from planopt.problems.channel_setup import LoggedMeasurements, RasterTruth
from planopt.problems.problem import Problem
from planopt.problems.rule_checks import MOST_PROBABLE_DRAWN
from planopt.problems.station_sources import log_of, raster_truth_of

ONE_STATION = "leave one entry of stations"


def check_stations(problem: Problem) -> None:
    """Raise what keeps a problem's stations from being planned with.

    Raises
    ------
    InputError
        A station has a key that does not go with the channel's tables, two stations have one name,
        one map of gains or one column of a log, or something is asked that is only there for one
        station.
    """
    _check_keys(problem)
    if len(problem.stations) > 1:
        _check_own_channels(problem)
        _check_rule(problem)


def _check_keys(problem: Problem) -> None:
    """Keys of a station that go only with a map or a log."""
    raster = isinstance(problem.channel.truth, RasterTruth)
    logged = isinstance(problem.channel.measurements, LoggedMeasurements)
    for number, radio in enumerate(problem.stations):
        for key, there, goes, table in (
            ("gain_file", radio.gain_file, raster, 'channel.truth of kind "raster"'),
            ("gain_variable", radio.gain_variable, raster, 'channel.truth of kind "raster"'),
            ("log_file", radio.log_file, logged, "channel.measurements.file"),
            ("power_column", radio.power_column, logged, "channel.measurements.file"),
            ("censored_column", radio.censored_column, logged, "channel.measurements.file"),
        ):
            if there is not None and not goes:
                raise InputError(
                    f"goes only with {table}",
                    file=problem.file,
                    key=f"stations[{number}].{key}",
                    remedy="leave it out",
                )


def _check_own_channels(problem: Problem) -> None:
    truth, log = problem.channel.truth, problem.channel.measurements
    _no_two_alike(
        problem,
        [radio.name for radio in problem.stations],
        "name",
        "is that of stations[{other}] too",
        "give each station a name of its own",
    )
    if isinstance(truth, RasterTruth):
        maps = [raster_truth_of(truth, radio) for radio in problem.stations]
        _no_two_alike(
            problem,
            [(own.file, own.variable) for own in maps],
            "gain_file",
            "is needed: the map of path gains would be that of stations[{other}]",
            "give each further station a gain_file, or a gain_variable of the same file",
        )
    if isinstance(log, LoggedMeasurements):
        logs = [log_of(log, radio) for radio in problem.stations]
        _no_two_alike(
            problem,
            [(own.file, own.columns[2]) for own in logs],
            "log_file",
            "is needed: the measured powers would be those of stations[{other}]",
            "give each further station a log_file, or a power_column of the same log",
        )


def _no_two_alike(
    problem: Problem, values: Sequence[object], key: str, words: str, remedy: str
) -> None:
    for number, value in enumerate(values):
        other = values.index(value)
        if other < number:
            raise InputError(
                words.format(other=other),
                file=problem.file,
                key=f"stations[{number}].{key}",
                remedy=remedy,
            )


def _check_rule(problem: Problem) -> None:
    rule = problem.constraints.rule
    p_min = problem.constraints.p_min
    if rule.connectivity == "joint" and p_min > MOST_PROBABLE_DRAWN:
        raise InputError(
            f"is {p_min:g}, and more than {MOST_PROBABLE_DRAWN:g} cannot be shown of all steps "
            f"together with {len(problem.stations)} stations",
            file=problem.file,
            key="constraints.p_min",
            remedy=f"ask for less, or {ONE_STATION}",
        )
    if rule.parameter_uncertainty == "all":
        raise InputError(
            f"all is for one station, and there are {len(problem.stations)}",
            file=problem.file,
            key="constraints.parameter_uncertainty",
            remedy=f"ask for path_loss, or {ONE_STATION}",
        )
