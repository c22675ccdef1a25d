"""Leave-one-out predictions: against conditioning again without the measurement."""

import numpy as np
import pytest

from planopt.channel.connection.connection_law import leave_one_out
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import condition

PARAMETERS = ChannelParameters(-30.0, 3.0, 6.0, 20.0, 2.0, Station((5.0, -20.0), 3.0))


def measured(count: int, seed: int = 0) -> Measurements:
    """Powers of no particular channel, none censored."""
    generator = np.random.default_rng(seed)
    places = generator.uniform(0.0, 100.0, (count, 2))
    return Measurements(places, generator.normal(-80.0, 7.0, count), np.zeros(count, dtype=bool))


@pytest.mark.parametrize("theta", ["estimated", "known"])
def test_as_conditioned_without_it(theta):
    """Mean and deviation of every one, theta estimated without it too."""
    data = measured(40)
    posterior = condition(PARAMETERS, data, theta=theta)
    rows = np.array([0, 3, 17, 39])
    found = leave_one_out(posterior, rows)
    for row, mean, deviation in zip(rows, found.mean_db, found.deviation_db, strict=True):
        rest = condition(PARAMETERS, data.take(np.arange(40) != row), theta=theta)
        expected = rest.predict(data.positions_m[row : row + 1])
        assert mean == pytest.approx(expected.mean_db[0], abs=1e-9)
        assert deviation == pytest.approx(expected.deviation_db[0], abs=1e-9)


def test_from_the_nearest_where_there_is_no_factor():
    """Beyond the exact limit the nearest others tell nearly the same, and never itself."""
    data = measured(400, 1)
    exact = leave_one_out(condition(PARAMETERS, data, theta="known"), np.arange(400))
    near = condition(PARAMETERS, data, theta="known", exact_limit=100)
    assert not near.has_factor
    found = leave_one_out(near, np.arange(400))
    np.testing.assert_allclose(found.deviation_db, exact.deviation_db, rtol=2e-3)
    np.testing.assert_allclose(found.mean_db, exact.mean_db, atol=0.1)


def test_shares_a_place_with_others():
    """Measurements at one place: each is left out by its number, not by its place."""
    data = measured(90, 2)
    places = np.concatenate([np.repeat(data.positions_m[:1], 80, axis=0), data.positions_m[80:]])
    same = Measurements(places, data.power_dbm, data.censored)
    near = condition(PARAMETERS, same, theta="known", exact_limit=10)
    found = leave_one_out(near, np.array([0]))
    assert found.deviation_db[0] == pytest.approx(
        leave_one_out(condition(PARAMETERS, same, theta="known"), np.array([0])).deviation_db[0],
        rel=1e-2,
    )
