"""The posterior beyond its limit, by neighbours, against the exact one."""

import numpy as np
import pytest

from planopt.channel import (
    ChannelParameters,
    Measurements,
    Station,
    at_time,
    condition,
    receiver_offsets,
)
from planopt.channel.channel_map import TileMap
from planopt.channel.kriging import LocalChannel, predict
from planopt.channel.measurements import join
from planopt.channel.parameters import regressors
from planopt.channel.posterior import EXACT_LIMIT

PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 15.0, 2.0, Station((5.0, -10.0), 12.0))
PLACES = np.random.default_rng(9).uniform(-110.0, 110.0, (300, 2))
SEVERAL = np.random.default_rng(5).integers(0, 3, 3000)


def measured(count, seed=0, share=0.0, **more):
    """Random measurements about path loss, `share` of them at the receiver's floor."""
    generator = np.random.default_rng(seed)
    positions = generator.uniform(-100.0, 100.0, (count, 2))
    mean = regressors(positions, PARAMETERS.station) @ [PARAMETERS.k_pl_db, PARAMETERS.n_pl]
    # Smooth over some 15 m, as shadowing is.
    waves = generator.normal(0.0, 1.0 / 15.0, (2, 30))
    phases = generator.uniform(0.0, 6.28, 30)
    shadow = 6.0 * np.sqrt(2.0 / 30.0) * np.cos(positions @ waves + phases).sum(axis=1)
    power = mean + shadow + 2.0 * generator.standard_normal(count)
    floor = np.quantile(power, share)
    at_floor = power < floor
    return Measurements(positions, np.maximum(power, floor), at_floor, **more)


def assert_close(found, exact, mean_db, deviation):
    """Largest error of the mean, and of the deviation as a share."""
    assert np.abs(found.mean_db - exact.mean_db).max() < mean_db
    assert np.abs(found.deviation_db / exact.deviation_db - 1.0).max() < deviation


def assert_same(one, other, tolerance=1e-10):
    np.testing.assert_allclose(one.mean_db, other.mean_db, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(one.deviation_db, other.deviation_db, rtol=0.0, atol=tolerance)


def test_as_accurate_as_stated():
    """Theta within 0.1 of its error, the mean within 2e-3 dB of 2.8; with limits within 0.5 dB."""
    data = measured(1500)
    exact, found = condition(PARAMETERS, data), condition(PARAMETERS, data, exact_limit=0)
    errors = np.sqrt(np.diag(exact.theta_covariance))
    assert exact.has_factor and not found.has_factor
    assert (np.abs(found.theta - exact.theta) < 0.1 * errors).all()
    np.testing.assert_allclose(np.sqrt(np.diag(found.theta_covariance)), errors, rtol=0.02)
    assert_close(found.predict(PLACES), exact.predict(PLACES), 0.04, 1e-3)
    known = [
        condition(PARAMETERS, data, theta="known", exact_limit=limit) for limit in (EXACT_LIMIT, 0)
    ]
    assert_close(known[1].predict(PLACES), known[0].predict(PLACES), 2e-3, 1e-4)
    assert (known[1].theta_covariance == 0.0).all()
    data = measured(1200, share=0.33)
    exact, found = (condition(PARAMETERS, data, exact_limit=k).predict(PLACES) for k in (1200, 0))
    assert_close(found, exact, 0.5, 0.05)
    assert np.sqrt(np.mean((found.mean_db - exact.mean_db) ** 2)) < 0.1


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_one_by_one_equals_all_at_once(share):
    """Appended singly or together, to 1e-10; censored ones included, in the order given."""
    data = measured(700, share=share, receiver=SEVERAL[:700])
    start = condition(PARAMETERS, data.take(slice(0, 600)), exact_limit=500)
    singly = start
    for row in range(600, 700):
        singly = singly.extend(data.take(slice(row, row + 1)))
    together = start.extend(data.take(slice(600, 700)))
    np.testing.assert_allclose(singly.theta, together.theta, atol=1e-10)
    np.testing.assert_allclose(singly.theta_covariance, together.theta_covariance, atol=1e-10)
    np.testing.assert_allclose(singly.values_db, together.values_db, rtol=1e-10)
    assert_same(singly.predict(PLACES), together.predict(PLACES))
    assert len(start.measurements) == 600 and len(singly.measurements) == 700


@pytest.mark.parametrize("limit", [299, 300, 301])
def test_the_first_one_beyond_the_limit_drops_the_factor(limit):
    """Coming from below the limit or starting beyond it gives the same posterior."""
    data = measured(310)
    grown = condition(PARAMETERS, data.take(slice(0, 290)), exact_limit=limit)
    for row in range(290, limit + 1):
        assert grown.has_factor
        grown = grown.extend(data.take(slice(row, row + 1)))
    batch = condition(PARAMETERS, data.take(slice(0, limit + 1)), exact_limit=limit)
    assert not grown.has_factor and not batch.has_factor
    np.testing.assert_allclose(grown.theta, batch.theta, atol=1e-10)
    assert_same(grown.predict(PLACES), batch.predict(PLACES))


def test_a_limit_taken_in_beyond_is_close_to_one_taken_in_exactly():
    """A censored measurement's site by its neighbours, and what it changes."""
    data = measured(900)
    spot = np.array([[20.0, 30.0]])
    exact, found = (condition(PARAMETERS, data, exact_limit=limit) for limit in (2000, 0))
    limit = Measurements(spot, exact.predict(spot).mean_db - 3.0, np.array([True]))
    exact, found = exact.extend(limit), found.extend(limit)
    assert found.values_db[-1] == pytest.approx(exact.values_db[-1], abs=0.1)
    assert found.noise_variance_db2[-1] == pytest.approx(exact.noise_variance_db2[-1], rel=0.02)
    assert found.predict(spot).mean_db[0] == pytest.approx(exact.predict(spot).mean_db[0], abs=0.02)


def test_position_errors_receivers_and_age():
    """Everything a measurement may have, close to the exact posterior; offsets of receivers too."""
    drifting = ChannelParameters(-40.0, 3.0, 6.0, 15.0, 2.0, PARAMETERS.station, 500.0)
    generator = np.random.default_rng(3)
    data = measured(
        800,
        receiver=SEVERAL[:800],
        time_s=generator.uniform(0.0, 300.0, 800),
        position_std_m=generator.uniform(0.0, 3.0, 800),
    )
    exact, found = (condition(drifting, data, exact_limit=limit) for limit in (800, 0))
    for one, other in zip(receiver_offsets(found), receiver_offsets(exact), strict=True):
        assert one.receiver == other.receiver
        assert one.offset_db == pytest.approx(other.offset_db, abs=0.03)
        assert one.standard_error_db == pytest.approx(other.standard_error_db, rel=0.02)
    assert_close(found.predict(PLACES), exact.predict(PLACES), 0.05, 2e-3)
    later = [at_time(posterior, 700.0).predict(PLACES) for posterior in (found, exact)]
    assert_close(*later, 0.05, 2e-3)
    unsure = [predict(posterior, PLACES, np.full(300, 4.0)) for posterior in (found, exact)]
    assert_close(*unsure, 0.05, 2e-3)
    assert (unsure[0].deviation_db > found.predict(PLACES).deviation_db).all()
    more = measured(3, seed=8, receiver=np.array([0, 1, 4]), position_std_m=np.ones(3))
    assert_close(found.extend(more).predict(PLACES), exact.extend(more).predict(PLACES), 0.05, 2e-3)


def test_lattice_and_neighbours_need_no_factor():
    """What planners use is the same with and without a factor, but for theta."""
    data = measured(600)
    x = np.linspace(-50.0, 50.0, 21)
    exact, found = (
        condition(PARAMETERS, data, theta="known", exact_limit=limit) for limit in (600, 0)
    )
    lattices = []
    for posterior in (exact, found):
        lattice = TileMap(x, x, np.ones((21, 21), dtype=bool))
        lattice.refresh(posterior)
        lattice.refresh(posterior.extend(measured(1, seed=4)))
        lattices.append(lattice)
    assert_same(*lattices)
    assert_same(*(LocalChannel.around(one, PLACES, 40).predict(PLACES) for one in (exact, found)))
    whole = [TileMap(x, x, np.ones((21, 21), dtype=bool), neighbours=600) for _ in range(2)]
    for lattice, posterior in zip(whole, (exact, found), strict=True):
        lattice.refresh(posterior)
    assert_close(*whole, 2e-3, 1e-4)


def test_continues():
    """An extension continues what it extends, at any time; other data or parameters do not."""
    data = measured(30, receiver=SEVERAL[:30])
    start = condition(PARAMETERS, data)
    grown = start.extend(measured(2, seed=1))
    assert (
        grown.continues(start) and start.continues(start) and at_time(grown, 9.0).continues(start)
    )
    assert not start.continues(grown)
    assert not condition(PARAMETERS, measured(30)).continues(start)
    assert not condition(PARAMETERS, measured(30, seed=2, receiver=SEVERAL[:30])).continues(start)
    louder = ChannelParameters(-40.0, 3.0, 7.0, 15.0, 2.0, PARAMETERS.station)
    assert not condition(louder, data).continues(start)
    assert condition(PARAMETERS, join(data, measured(3))).continues(start)
