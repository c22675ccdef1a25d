"""Measurements with ages, receivers, errors of position and limits, for the tests of covariances.

The covariance stands here once more, pair by pair, as an oracle.
"""

import math
from dataclasses import replace

import numpy as np

from planopt.channel import ChannelParameters, Measurements, Station

DRIFTING = ChannelParameters(-10.0, 2.0, 4.0, 12.0, 1.5, Station((25.0, 60.0), 5.0), 300.0)
STEADY = replace(DRIFTING, forgetting_s=math.inf)
OFFSETS_DB = np.array([0.0, 6.0, -3.0])


def varied(count, seed=0, *, censored=0.0, errors=True, receivers=3):
    """Uniform places on 50 m, times over 600 s, receivers in turn, some places known exactly."""
    generator = np.random.default_rng(seed)
    positions = generator.uniform(0.0, 50.0, (count, 2))
    distance = np.hypot(positions[:, 0] - 25.0, positions[:, 1] - 60.0)
    receiver = np.arange(count) % receivers
    power = -10.0 - 20.0 * np.log10(distance) + generator.normal(0.0, 4.0, count)
    power += OFFSETS_DB[receiver]
    floor = np.quantile(power, censored) if censored else -np.inf
    std = np.where(np.arange(count) % 2, generator.uniform(0.5, 3.0, count), 0.0)
    return Measurements(
        positions,
        np.maximum(power, floor),
        power < floor,
        position_std_m=std if errors else np.zeros(count),
        time_s=np.sort(generator.uniform(0.0, 600.0, count)),
        receiver=receiver,
    )


def pair_covariance(parameters, i, first, j, second, *, same):
    """Covariance of two measurements but for independent noise, from its definition."""
    xi2 = parameters.shadow_std_db**2
    offset = 400.0 if first.receiver[i] == second.receiver[j] != 0 else 0.0
    if same and i == j:
        return xi2 + offset
    squared = ((first.positions_m[i] - second.positions_m[j]) ** 2).sum()
    squared += 1.2 * (first.position_std_m[i] ** 2 + second.position_std_m[j] ** 2)
    age = abs(first.time_s[i] - second.time_s[j])
    shadow = xi2 * math.exp(-math.sqrt(squared) / parameters.decorrelation_m)
    return shadow * math.exp(-age / parameters.forgetting_s) + offset


def dense_covariance(parameters, first, second=None):
    other = first if second is None else second
    return np.array(
        [
            [
                pair_covariance(parameters, i, first, j, other, same=second is None)
                for j in range(len(other))
            ]
            for i in range(len(first))
        ]
    )


def at_places(places, now_s, position_std_m=0.0):
    """Places to predict at, as measurements that receiver 0 would take."""
    count = len(places)
    return Measurements(
        places,
        np.zeros(count),
        np.zeros(count, bool),
        position_std_m=np.full(count, position_std_m),
        time_s=np.full(count, now_s),
    )


def dense_prediction(posterior, places, now_s, position_std_m=0.0):
    """Universal kriging written out: mean and deviation of the power that would be measured."""
    parameters, data = posterior.parameters, posterior.measurements
    total = dense_covariance(parameters, data) + np.diag(posterior.noise_variance_db2)
    across = dense_covariance(parameters, data, at_places(places, now_s, position_std_m))

    def gamma(positions):
        x, y = parameters.station.position_m
        square = (positions[:, 0] - x) ** 2 + (positions[:, 1] - y) ** 2
        square += parameters.station.height_m**2
        return np.column_stack([np.ones(len(positions)), -5.0 * np.log10(square)])

    weight = np.linalg.inv(total)
    columns, trend = gamma(data.positions_m), gamma(places)
    spread = np.linalg.inv(columns.T @ weight @ columns)
    theta = spread @ columns.T @ weight @ posterior.values_db
    left = trend - across.T @ weight @ columns
    mean = trend @ theta + across.T @ weight @ (posterior.values_db - columns @ theta)
    variance = parameters.shadow_std_db**2 + parameters.multipath_std_db**2
    variance = variance - np.einsum("ij,ik,kj->j", across, weight, across)
    variance = variance + np.einsum("ni,ij,nj->n", left, spread, left)
    return mean, np.sqrt(variance)
