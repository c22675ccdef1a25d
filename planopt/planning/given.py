"""What a problem and a seed give before anything is learnt: truth and first measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.fields.truth import Truth, measure, model_truth, raster_truth
from planopt.channel.logs.log_file import read_log
from planopt.channel.logs.log_format import LogFormat
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters
from planopt.errors import InputError
from planopt.problems.channel_setup import LoggedMeasurements, ModelTruth, RasterTruth
from planopt.problems.problem import Problem
from planopt.problems.station_sources import log_of, raster_truth_of
from planopt.world.clearance import clearance_m, index_obstacles
from planopt.world.raster_files import read_raster

LARGEST_GAIN_DB = 500.0
"""Path gains of maps are within this of 0 dB, as those of problem files."""

FURTHER_STREAMS = 2
"""The first station's fading, the measured places and what a team draws have other streams."""


@dataclass(frozen=True, eq=False)
class Given:
    """What a seed fixes.

    Attributes
    ----------
    truth
        The channel as it is; None if the problem has none.
    measurements
        The first measurements.
    further
        The same of each further station, in the problem's order; they have none.
    """

    truth: Truth | None
    measurements: Measurements
    further: tuple[Given, ...] = ()

    @property
    def stations(self) -> tuple[Given, ...]:
        """What there is of each station, the first one's first."""
        return (self, *self.further)

    @property
    def truths(self) -> tuple[Truth, ...]:
        """Of each station; empty if the problem has none."""
        return tuple(given.truth for given in self.stations if given.truth is not None)


def draw(problem: Problem, seed: int) -> Given:
    """Draw the truth, and take or read the first measurements.

    Parameters
    ----------
    problem
        The problem.
    seed
        Fixes the fading and the measured places; streams of their own, so that more measurements
        leave the fading as it was, and more stations all that there was.

    Raises
    ------
    InputError
        The seed is negative, a file cannot be used, or there is nothing to measure.
    """
    if seed < 0:
        raise InputError(f"is {seed}, should be at least 0", key="seed")
    fading_seed, places_seed = np.random.SeedSequence(seed).spawn(2)
    fading_seeds = [fading_seed] + [
        np.random.SeedSequence(seed, spawn_key=(FURTHER_STREAMS, number))
        for number in range(1, len(problem.stations))
    ]
    truths = [
        draw_truth(problem, np.random.default_rng(stream), station)
        for station, stream in enumerate(fading_seeds)
    ]
    setup = problem.channel.measurements
    if isinstance(setup, LoggedMeasurements):
        measured = [_read_log(log_of(setup, radio)) for radio in problem.stations]
    else:
        places = free_places(problem, setup.count, np.random.default_rng(places_seed))
        measured = [_measured(problem, truth, places) for truth in truths]
    stations = [Given(*both) for both in zip(truths, measured, strict=True)]
    return replace(stations[0], further=tuple(stations[1:]))


def _read_log(log: LoggedMeasurements) -> Measurements:
    return read_log(log.file, LogFormat(log.columns, log.censored_column, log.floor_dbm))


def _measured(problem: Problem, truth: Truth | None, places_m: NDArray[np.float64]) -> Measurements:
    if truth is None:
        raise InputError(
            "there is no truth to measure",
            file=problem.file,
            key="channel.truth",
            remedy="give channel.truth, or a log as channel.measurements.file",
        )
    return measure(truth, places_m)


def draw_truth(problem: Problem, generator: np.random.Generator, station: int = 0) -> Truth | None:
    """Make the simulator's truth of one station, or None if the problem has none."""
    setup, radio = problem.channel.truth, problem.stations[station]
    if isinstance(setup, RasterTruth):
        setup = raster_truth_of(setup, radio)
        gain = read_raster(setup.file, setup.variable)
        # A comparison with NaN is false: no value is no fault.
        if (np.abs(gain.values) > LARGEST_GAIN_DB).any():
            raise InputError(
                f"has values from {np.nanmin(gain.values):g} to {np.nanmax(gain.values):g}, which "
                "are no path gains in dB",
                file=setup.file,
                key=setup.variable,
                remedy=f"give decibels within {LARGEST_GAIN_DB:g}",
            )
        return raster_truth(
            gain, radio.transmit_power_dbm, setup.floor_db, setup.multipath, generator
        )
    if isinstance(setup, ModelTruth):
        parameters = ChannelParameters(
            k_pl_db=setup.k_pl_db + radio.transmit_power_dbm,
            n_pl=setup.n_pl,
            shadow_std_db=setup.shadow_std_db,
            decorrelation_m=setup.decorrelation_m,
            multipath_std_db=setup.multipath_std_db,
            station=radio.site,
        )
        floor = None if setup.floor_db is None else setup.floor_db + radio.transmit_power_dbm
        return model_truth(
            parameters,
            problem.workspace.bounds_m,
            setup.cell_m,
            floor,
            generator,
            setup.multipath,
        )
    return None


def free_places(
    problem: Problem, count: int, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Draw `count` places uniformly from the workspace outside obstacles; (count, 2).

    Raises
    ------
    InputError
        The obstacles leave no place.
    """
    index = index_obstacles(problem.workspace)
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    kept: list[NDArray[np.float64]] = []
    found = 0
    for _ in range(1000):
        drawn = generator.uniform((x_min, y_min), (x_max, y_max), (max(2 * count, 64), 2))
        free = drawn[clearance_m(index, drawn) > 0.0]
        kept.append(free)
        found += len(free)
        if found >= count:
            return np.concatenate(kept)[:count]
    raise InputError(
        "the obstacles leave no place to measure at", file=problem.file, key="world.obstacles"
    )
