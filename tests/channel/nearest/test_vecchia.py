"""Information by Vecchia's approximation, receivers' offsets included, against dense formulas."""

import numpy as np
import pytest

from planopt.channel import ChannelParameters, Measurements, Station
from planopt.channel.long_logs import vecchia_information
from planopt.channel.measurements import (
    RECEIVER_OFFSET_STD_DB,
    measured_origins,
    own_covariance_db2,
)
from planopt.channel.neighbours import BLOCK, BLOCK_NEIGHBOURS
from planopt.channel.parameters import regressors

PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))


def measured(count, receivers=(0,), seed=0, places=None):
    """Random measurements by receivers, with their values and noise."""
    generator = np.random.default_rng(seed)
    data = Measurements(
        generator.uniform(-100.0, 100.0, (count, 2)) if places is None else places,
        generator.normal(-90.0, 6.0, count),
        np.zeros(count, dtype=bool),
        receiver=np.asarray(receivers)[np.arange(count) % len(receivers)],
    )
    return data, data.power_dbm, generator.uniform(1.0, 9.0, count)


def dense(data, values, noise):
    """C' U^-1 C of [y - Gamma theta_0, Gamma]; U^-1."""
    gamma = regressors(data.positions_m, PARAMETERS.station)
    columns = np.column_stack([values - gamma @ [-40.0, 3.0], gamma])
    covariance = own_covariance_db2(measured_origins(data, PARAMETERS), PARAMETERS)
    inverse = np.linalg.inv(covariance + np.diag(noise))
    return columns.T @ inverse @ columns, inverse


@pytest.mark.parametrize("count", [0, 1, BLOCK + 1, BLOCK_NEIGHBOURS + 20])
def test_with_all_earlier_ones_it_is_exact(count):
    """Nothing is left out while there are no more than `BLOCK_NEIGHBOURS` before any block."""
    given = measured(count)
    found = vecchia_information(PARAMETERS, *given).products
    np.testing.assert_allclose(found, dense(*given)[0], rtol=1e-9, atol=1e-9)


def test_the_order_of_a_batch_does_not_matter():
    """Products depend on the places, not on the order of the rows."""
    data, values, noise = measured(300)
    order = np.random.default_rng(1).permutation(300)
    np.testing.assert_allclose(
        vecchia_information(PARAMETERS, data.take(order), values[order], noise[order]).products,
        vecchia_information(PARAMETERS, data, values, noise).products,
        rtol=1e-9,
    )


@pytest.mark.parametrize("receivers", [[0], [0, 3, 1], [2, 5]])
def test_offsets_are_integrated_out(receivers):
    """[y - Gamma theta_0, Gamma] under the covariance that has the offsets' variance in it."""
    data, values, noise = measured(60, receivers)
    found = vecchia_information(PARAMETERS, data, values, noise)
    expected, inverse = dense(data, values, noise)
    np.testing.assert_allclose(found.path_loss_products(), expected, rtol=1e-9, atol=1e-9)
    numbers = sorted({*receivers} - {0})
    np.testing.assert_array_equal(found.receivers, numbers)
    indicators = (data.receiver[:, None] == numbers).astype(float)
    prior = RECEIVER_OFFSET_STD_DB**2
    given = prior * np.eye(len(numbers)) - prior**2 * indicators.T @ inverse @ indicators
    np.testing.assert_allclose(found.offset_covariance_db2(), given, atol=1e-8)
