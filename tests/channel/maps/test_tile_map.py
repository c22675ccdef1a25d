"""The cached lattice against the exact posterior and against building it anew."""

from itertools import pairwise

import numpy as np
import pytest

from planopt.channel import ChannelParameters, Measurements, Station, condition
from planopt.channel.channel_map import TileMap

PARAMETERS = ChannelParameters(-40.0, 3.0, 4.0, 20.0, 1.13, Station((5.0, -10.0), 12.0))
X = np.arange(33) * 3.0
Y = np.arange(27) * 3.0 - 10.0
NEEDED = np.random.default_rng(5).random((27, 33)) < 0.4
NEEDED[:10, :12] = False


def data(count, seed=0):
    generator = np.random.default_rng(seed)
    positions = generator.uniform(-10.0, 100.0, (count, 2))
    power = -80.0 + 4.0 * np.sin(positions[:, 0] / 15.0) + generator.standard_normal(count)
    return Measurements(positions, power, np.zeros(count, dtype=bool))


def fresh(posterior, neighbours):
    lattice = TileMap(X, Y, NEEDED, neighbours=neighbours)
    lattice.refresh(posterior)
    return lattice


def assert_same(one, two, tolerance=1e-9):
    np.testing.assert_allclose(one.mean_db, two.mean_db, atol=tolerance, rtol=0.0)
    np.testing.assert_allclose(one.deviation_db, two.deviation_db, atol=tolerance, rtol=0.0)


@pytest.mark.parametrize("count", [0, 1, 70])
def test_all_measurements_give_the_exact_posterior(count):
    """With enough neighbours each needed node has the exact prediction, others NaN."""
    posterior = condition(PARAMETERS, data(count))
    lattice = fresh(posterior, 70)
    xx, yy = np.meshgrid(X, Y)
    exact = posterior.predict(np.column_stack([xx[NEEDED], yy[NEEDED]]))
    np.testing.assert_allclose(lattice.mean_db[NEEDED], exact.mean_db, atol=1e-9)
    np.testing.assert_allclose(lattice.deviation_db[NEEDED], exact.deviation_db, atol=1e-9)
    assert np.isnan(lattice.mean_db[~NEEDED]).all()
    assert np.isnan(lattice.deviation_db[~NEEDED]).all()


def test_incremental_equals_fresh():
    """From no measurement to 90, singly and in groups, across the number of neighbours."""
    everything = data(90)
    posterior = condition(PARAMETERS, data(0))
    lattice = TileMap(X, Y, NEEDED, neighbours=12)
    edges = [0, 1, 2, 11, 12, 13, 14, 20, 21, 22, 40, 41, 42, 43, 44, 70, 71, 72, 88, 89, 90]
    for start, stop in pairwise(edges):
        piece = slice(start, stop)
        posterior = posterior.extend(
            Measurements(
                everything.positions_m[piece],
                everything.power_dbm[piece],
                everything.censored[piece],
            )
        )
        lattice.refresh(posterior)
        assert_same(lattice, fresh(posterior, 12))


def test_hundreds_of_updates_do_not_drift():
    """Measurements piling up at one place replace a tile's neighbours again and again."""
    posterior = condition(PARAMETERS, data(60))
    lattice = fresh(posterior, 12)
    generator = np.random.default_rng(11)
    for _ in range(120):
        spot = np.array([[50.0, 40.0]]) + generator.normal(0.0, 12.0, (1, 2))
        posterior = posterior.extend(Measurements(spot, np.array([-75.0]), np.array([False])))
        lattice.refresh(posterior)
    assert_same(lattice, fresh(posterior, 12))


def test_only_tiles_near_the_new_measurement_are_computed():
    """One more measurement in a corner touches few tiles, a repeated refresh none."""
    posterior = condition(PARAMETERS, data(300))
    lattice = TileMap(X, Y, NEEDED, neighbours=12)
    every = lattice.refresh(posterior)
    assert lattice.refresh(posterior) == 0
    corner = Measurements(np.array([[99.0, 70.0]]), np.array([-80.0]), np.array([False]))
    assert 0 < lattice.refresh(posterior.extend(corner)) < every / 3


def test_a_window_defers_the_rest():
    """Outside the window tiles wait: unchanged for now, right after the next full refresh."""
    posterior = condition(PARAMETERS, data(100))
    lattice = TileMap(X, Y, NEEDED, neighbours=12)
    lattice.refresh(posterior, window_m=(45.0, -20.0, 100.0, 100.0))
    expected = fresh(posterior, 12)
    right = X >= 54.0
    np.testing.assert_allclose(lattice.mean_db[:, right], expected.mean_db[:, right], atol=1e-9)
    assert np.isnan(lattice.mean_db[:, X <= 36.0]).all()
    more = posterior.extend(data(5, seed=3))
    assert lattice.refresh(more, window_m=(0.0, -20.0, 45.0, 100.0)) > 0
    lattice.refresh(more)
    assert_same(lattice, fresh(more, 12))
    assert lattice.refresh(more) == 0


@pytest.mark.parametrize("half_m", [1.0, 4.0, 11.0])
def test_every_node_of_a_window_is_known(half_m: float):
    """Tiles that a window only cuts are computed as well."""
    posterior = condition(PARAMETERS, data(100))
    expected = fresh(posterior, 12)
    for middle_x in X[3:-3:4]:
        for middle_y in Y[3:-3:5]:
            lattice = TileMap(X, Y, NEEDED, neighbours=12)
            window = middle_x - half_m, middle_y - half_m, middle_x + half_m, middle_y + half_m
            lattice.refresh(posterior, window_m=window)
            rows = np.flatnonzero((Y >= window[1]) & (Y <= window[3]))
            columns = np.flatnonzero((X >= window[0]) & (X <= window[2]))
            inside = np.ix_(rows, columns)
            np.testing.assert_allclose(lattice.mean_db[inside], expected.mean_db[inside])


def test_another_posterior_rebuilds_everything():
    """Other parameters or other data are not mistaken for an extension."""
    lattice = fresh(condition(PARAMETERS, data(60)), 12)
    other = condition(PARAMETERS, data(60, seed=1))
    lattice.refresh(other)
    assert_same(lattice, fresh(other, 12))
    louder = ChannelParameters(-40.0, 3.0, 5.0, 20.0, 1.13, PARAMETERS.station)
    reparametrised = condition(louder, data(60, seed=1))
    lattice.refresh(reparametrised)
    assert_same(lattice, fresh(reparametrised, 12))
    fewer = condition(louder, data(40, seed=1))
    lattice.refresh(fewer)
    assert_same(lattice, fresh(fewer, 12))


def test_a_new_theta_alone_is_recombined_everywhere():
    """A measurement far outside moves theta, so nodes it is no neighbour of follow."""
    posterior = condition(PARAMETERS, data(60))
    lattice = fresh(posterior, 12)
    before = lattice.mean_db.copy()
    far = posterior.extend(
        Measurements(np.array([[900.0, 900.0]]), np.array([-30.0]), np.array([False]))
    )
    assert lattice.refresh(far) == 0
    assert np.nanmax(np.abs(lattice.mean_db - before)) > 1e-6
    assert_same(lattice, fresh(far, 12))
