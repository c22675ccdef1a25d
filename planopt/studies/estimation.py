"""The cost of not knowing the channel: maps from a fitted channel against the true one's.

Channels are drawn from the model with known parameters, measured at random places, and predicted
all over the workspace: once with the true parameters, path loss included (the oracle, which no
estimate beats on average), and once with whatever a learner makes of the measurements.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planopt.channel.fields.field import scattered_field_db
from planopt.channel.joint import predict_readings
from planopt.channel.measurements import Measurements
from planopt.channel.multipath.multipath_models import Lognormal, Multipath, multipath_field_db
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import ChannelParameters, Station, regressors
from planopt.channel.posterior import condition
from planopt.channel.validation.calibration import calibrate
from planopt.channel.validation.held_out import (
    GroupedRatio,
    Predictor,
    grouped_ratio,
    learn_channel,
    learn_marginal,
)

Learner = Callable[[Measurements, Station], Predictor]
"""From measurements and the station to what predicts."""

LEARNERS: dict[str, Learner] = {"reml": learn_channel, "marginal": learn_marginal}

MAP_PLACES = 1000
"""Random places that stand for the map."""

LEVEL = 0.95
"""Of the intervals whose coverage is counted."""

ORACLE = "oracle"


@dataclass(frozen=True)
class EstimationCase:
    """A channel to be learnt, on a square.

    Attributes
    ----------
    name
        For the table.
    channel
        The truth.
    side_m
        Side of the square from (0, 0) that is measured and mapped.
    multipath
        Law of multipath; None for one that is Gaussian in dB with the channel's deviation.
    """

    name: str
    channel: ChannelParameters
    side_m: float
    multipath: Multipath | None = None


def published_case(name: str, side_m: float, multipath: Multipath | None = None) -> EstimationCase:
    """The channel of Fig. 3 (`fig3`) or Fig. 4 (`fig4`) of [GM11], the station in the centre.

    Parameters are theory's 3.3, B and C. The seed does not state the side.
    """
    decorrelation_m, multipath_std_db = {"fig3": (10.0, 1.99), "fig4": (20.0, 1.13)}[name]
    station = Station((0.5 * side_m, 0.5 * side_m))
    channel = ChannelParameters(-10.0, 2.0, 4.0, decorrelation_m, multipath_std_db, station)
    return EstimationCase(name, channel, side_m, multipath)


@dataclass(frozen=True)
class EstimationRow:
    """One learner on one case.

    Attributes
    ----------
    learner
        Its name, or ``oracle``.
    measurements, channels
        Number of measurements of a channel, and of channels.
    rmse_db
        Root mean squared error of predicted power over all maps, multipath included.
    of_oracle
        That over the oracle's on the same channels.
    latent_of_oracle
        The same for the error against path loss and shadowing alone: multipath, which nobody can
        predict, makes all maps look alike.
    coverage
        Share of powers within the central 95 % interval.

    All four have 95 % intervals over the channels.
    """

    learner: str
    measurements: int
    channels: int
    rmse_db: GroupedRatio
    of_oracle: GroupedRatio
    latent_of_oracle: GroupedRatio
    coverage: GroupedRatio


@one_blas_thread()
def estimation_study(
    case: EstimationCase,
    measurements: int,
    channels: int,
    seed: int = 0,
    learners: Mapping[str, Learner] = LEARNERS,
) -> tuple[EstimationRow, ...]:
    """Learn `channels` channels from `measurements` measurements each; a row a learner.

    Parameters
    ----------
    case
        What is drawn.
    measurements
        At places uniform over the square, for each channel.
    channels
        At least two. Channel k is the same whatever their number.
    seed
        Of everything drawn.
    learners
        By name; the oracle is always first of the rows.
    """
    names = [ORACLE, *learners]
    squares, latent_squares, inside = np.empty((3, len(names), channels))
    for index in range(channels):
        drawn = _draw(case, measurements, np.random.default_rng([seed, index]))
        known, everywhere = drawn.known, drawn.everywhere
        oracle = partial(predict_readings, condition(case.channel, known, theta="known"))
        learnt = [learn(known, case.channel.station) for learn in learners.values()]
        for row, predict in enumerate([oracle, *learnt]):
            prediction = predict(everywhere)
            found = calibrate(prediction, everywhere, (LEVEL,))
            squares[row, index] = found.rmse_db**2
            latent_squares[row, index] = np.mean((prediction.mean_db - drawn.latent_db) ** 2)
            inside[row, index] = found.coverage[0].share
    each = np.ones(channels)
    return tuple(
        EstimationRow(
            name,
            measurements,
            channels,
            grouped_ratio(squares[row], each).root(),
            grouped_ratio(squares[row], squares[0]).root(),
            grouped_ratio(latent_squares[row], latent_squares[0]).root(),
            grouped_ratio(inside[row], each),
        )
        for row, name in enumerate(names)
    )


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Measurements of a channel, and its map with and without multipath."""

    known: Measurements
    everywhere: Measurements
    latent_db: NDArray[np.float64]


def _draw(case: EstimationCase, measurements: int, generator: np.random.Generator) -> _Drawn:
    channel = case.channel
    count = measurements + MAP_PLACES
    positions = generator.uniform(0.0, case.side_m, (count, 2))
    theta = np.array([channel.k_pl_db, channel.n_pl])
    latent = regressors(positions, channel.station) @ theta
    latent += scattered_field_db(
        positions, channel.shadow_std_db, channel.decorrelation_m, generator
    )
    law = Lognormal(channel.multipath_std_db) if case.multipath is None else case.multipath
    power = latent + multipath_field_db((count,), law, generator)
    drawn = Measurements(positions, power, np.zeros(count, dtype=np.bool_))
    return _Drawn(
        drawn.take(slice(measurements)),
        drawn.take(slice(measurements, None)),
        latent[measurements:],
    )
