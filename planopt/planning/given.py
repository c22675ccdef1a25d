"""What a problem and a seed give before anything is learnt: truth and first measurements."""

from __future__ import annotations

from dataclasses import dataclass

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
from planopt.world.clearance import clearance_m, index_obstacles
from planopt.world.raster_files import read_raster


@dataclass(frozen=True, eq=False)
class Given:
    """What a seed fixes.

    Attributes
    ----------
    truth
        The channel as it is; None if the problem has none.
    measurements
        The first measurements.
    """

    truth: Truth | None
    measurements: Measurements


def draw(problem: Problem, seed: int) -> Given:
    """Draw the truth, and take or read the first measurements.

    Parameters
    ----------
    problem
        The problem.
    seed
        Fixes the fading and the measured places; two streams, so that more measurements leave the
        fading as it was.

    Raises
    ------
    InputError
        The seed is negative, a file cannot be used, or there is nothing to measure.
    """
    if seed < 0:
        raise InputError(f"is {seed}, should be at least 0", key="seed")
    fading_seed, places_seed = np.random.SeedSequence(seed).spawn(2)
    truth = draw_truth(problem, np.random.default_rng(fading_seed))
    setup = problem.channel.measurements
    if isinstance(setup, LoggedMeasurements):
        measurements = read_log(
            setup.file, LogFormat(setup.columns, setup.censored_column, setup.floor_dbm)
        )
    elif truth is None:
        raise InputError(
            "there is no truth to measure",
            file=problem.file,
            key="channel.truth",
            remedy="give channel.truth, or a log as channel.measurements.file",
        )
    else:
        places = free_places(problem, setup.count, np.random.default_rng(places_seed))
        measurements = measure(truth, places)
    return Given(truth, measurements)


def draw_truth(problem: Problem, generator: np.random.Generator) -> Truth | None:
    """Make the simulator's truth, or None if the problem has none."""
    setup, radio = problem.channel.truth, problem.stations[0]
    if isinstance(setup, RasterTruth):
        gain = read_raster(setup.file, setup.variable)
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
