"""A channel, measurements drawn from it, and a path, for the tests of objectives."""

import numpy as np

from planopt import Measurements
from planopt.channel import ChannelParameters, Station
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import regressors
from planopt.objectives.measuring import MeasuringRule

CHANNEL = ChannelParameters(-35.0, 2.8, 5.0, 12.0, 2.0, Station((3.0, -4.0), 6.0))
NOTHING = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
SPACING_M = 2.0
START = (10.0, 12.0)
PATH = np.array([[13.0, 14.0], [17.0, 13.0], [19.0, 18.0], [24.0, 21.0], [23.0, 27.0]])


def drawn(count, seed=0, channel=CHANNEL, side_m=60.0):
    """Powers drawn from the model at uniform places."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(0.0, side_m, (count, 2))
    return Measurements(
        positions, power_at(positions, channel, rng, 1)[0], np.zeros(count, dtype=bool)
    )


def power_at(positions, channel, rng, count):
    """Draws of the powers at all of `positions` together."""
    covariance = shadow_covariance_db2(positions, positions, channel)
    covariance += channel.multipath_std_db**2 * np.eye(len(positions))
    mean = regressors(positions, channel.station) @ [channel.k_pl_db, channel.n_pl]
    lower = np.linalg.cholesky(covariance)
    return mean + rng.standard_normal((count, len(positions))) @ lower.T


def measured_at(path, seed=9):
    """Some powers at the places of a path: what is known afterwards does not depend on them."""
    power = np.random.default_rng(seed).normal(-80.0, 5.0, len(path))
    return Measurements(path, power, np.zeros(len(path), dtype=bool))


def moved(measurements, turn, shift, scale=1.0):
    """The measurements of a scene that is scaled, turned (or mirrored) and shifted."""
    return Measurements(
        scale * measurements.positions_m @ turn.T + shift,
        measurements.power_dbm,
        measurements.censored,
    )


def partly_open(seed):
    """A rule and a path with partly open gates, away from points where measuring changes."""
    rng = np.random.default_rng(seed)
    while True:
        known = rng.uniform(0.0, 7.0, (3, 2))
        way = rng.uniform(0.0, 7.0, (5, 2))
        rule = MeasuringRule(SPACING_M, (known,))
        gates = rule.gates(way[None])
        if gates is None:
            continue
        value = gates.value[0]
        places = np.vstack([known, way])
        apart = np.linalg.norm(way[:, None] - places, axis=2)
        near_edge = np.abs(apart - SPACING_M) < 1e-3
        if not near_edge.any() and ((value > 0.05) & (value < 0.95)).sum() >= 2:
            return rule, way, gates
