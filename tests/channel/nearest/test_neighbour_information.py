"""Sums over all measurements, with receivers' offsets, against dense formulas."""

import numpy as np
import pytest

from planopt.channel.measurement_covariance import (
    RECEIVER_OFFSET_STD_DB,
    measured_origins,
    own_covariance_db2,
)
from planopt.channel.measurements import Measurements
from planopt.channel.nearest.neighbour_information import (
    extended_information,
    neighbour_information,
)
from planopt.channel.nearest.place_index import PlaceIndex
from planopt.channel.parameters import ChannelParameters, Station, regressors

PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))


def measured(count, receivers, seed=0):
    """Random measurements by receivers, with their values and noise."""
    generator = np.random.default_rng(seed)
    data = Measurements(
        generator.uniform(-100.0, 100.0, (count, 2)),
        generator.normal(-90.0, 6.0, count),
        np.zeros(count, dtype=bool),
        receiver=np.asarray(receivers)[np.arange(count) % len(receivers)],
    )
    return data, data.power_dbm, generator.uniform(1.0, 9.0, count)


@pytest.mark.parametrize("receivers", [[0], [0, 3, 1], [2, 5]])
def test_offsets_are_integrated_out(receivers):
    """[y - Gamma theta_0, Gamma] under the covariance that has the offsets' variance in it."""
    data, values, noise = measured(60, receivers)
    found = neighbour_information(PARAMETERS, data, values, noise)
    gamma = regressors(data.positions_m, PARAMETERS.station)
    columns = np.column_stack([values - gamma @ [-40.0, 3.0], gamma])
    covariance = own_covariance_db2(measured_origins(data, PARAMETERS), PARAMETERS)
    inverse = np.linalg.inv(covariance + np.diag(noise))
    np.testing.assert_allclose(
        found.path_loss_products(), columns.T @ inverse @ columns, rtol=1e-9, atol=1e-9
    )
    numbers = sorted({*receivers} - {0})
    np.testing.assert_array_equal(found.receivers, numbers)
    indicators = (data.receiver[:, None] == numbers).astype(float)
    prior = RECEIVER_OFFSET_STD_DB**2
    given = prior * np.eye(len(numbers)) - prior**2 * indicators.T @ inverse @ indicators
    np.testing.assert_allclose(found.offset_covariance_db2(), given, atol=1e-8)


def test_extended_singly_or_at_once():
    """A batch and its measurements one by one add the same, new receivers included."""
    data, values, noise = measured(400, [0, 0, 4])
    new = data.receiver.copy()
    new[370:] = np.arange(30) % 6
    data = Measurements(data.positions_m, data.power_dbm, data.censored, receiver=new)

    def first(count):
        return data.take(slice(0, count)), values[:count], noise[:count]

    def index(count):
        return PlaceIndex.of(data.positions_m[:count])

    start = neighbour_information(PARAMETERS, *first(350))
    at_once = extended_information(start, index(350), PARAMETERS, *first(400))
    singly = start
    for count in range(351, 401):
        singly = extended_information(singly, index(count - 1), PARAMETERS, *first(count))
    np.testing.assert_array_equal(singly.receivers, [1, 2, 3, 4, 5])
    np.testing.assert_array_equal(at_once.receivers, singly.receivers)
    np.testing.assert_allclose(at_once.products, singly.products, rtol=1e-10, atol=1e-10)
    np.testing.assert_array_equal(start.receivers, [4])
