"""From a problem to what its robots know at the start: truth, first measurements, belief."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.fit import fit_channel
from planopt.channel.log_file import read_log
from planopt.channel.measurements import Measurements
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import ChannelParameters
from planopt.channel.posterior import condition
from planopt.channel.truth import Truth, measure, model_truth, raster_truth
from planopt.errors import InputError
from planopt.problems.problem import LoggedMeasurements, ModelTruth, Problem, RasterTruth
from planopt.world.clearance import clearance_m, index_obstacles
from planopt.world.raster_files import read_raster


@dataclass(frozen=True)
class Prepared:
    """What a seed fixes before planning begins.

    Attributes
    ----------
    truth
        The channel as it is; None if the problem has none.
    belief
        What the first measurements tell.
    """

    truth: Truth | None
    belief: Belief


@one_blas_thread()
def prepare(problem: Problem, seed: int) -> Prepared:
    """Draw the truth, take or read the first measurements, fit the channel, condition on them.

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
        measurements = read_log(setup.file, setup.columns, setup.censored_column, setup.floor_dbm)
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
    return Prepared(truth, learn(problem, measurements))


def learn(problem: Problem, measurements: Measurements) -> Belief:
    """Fit the channel of the problem's station to measurements and condition on them."""
    fit = fit_channel(measurements, problem.stations[0].site, problem.channel.fit_method)
    return Belief(fit, condition(fit.parameters, measurements))


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
