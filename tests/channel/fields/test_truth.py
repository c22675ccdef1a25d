"""The simulator's truth: seeded, fixed in place, clipped at the floor."""

from dataclasses import replace

import numpy as np
import pytest

from planopt.channel import (
    ChannelParameters,
    Nakagami,
    Rician,
    Station,
    measure,
    model_truth,
    raster_truth,
    true_power_dbm,
)
from planopt.channel.parameters import regressors
from planopt.world.raster import Raster

GAINS = np.array([[-80.0, -100.0, np.nan], [-129.0, -131.0, -95.0]])
MAP = Raster(np.array([0.0, 2.0, 4.0]), np.array([10.0, 12.0]), GAINS)
CENTRES = np.array([[x, y] for y in (10.0, 12.0) for x in (0.0, 2.0, 4.0)])
PARAMETERS = ChannelParameters(-40.0, 3.0, 5.0, 20.0, 2.0, Station((-10.0, 5.0), 8.0))


def test_gains_become_powers_clipped_at_the_floor():
    """Transmit power added, NaN and weak gains at the floor, the map itself untouched."""
    truth = raster_truth(MAP, 30.0, -130.0, None, np.random.default_rng(0))
    np.testing.assert_array_equal(
        true_power_dbm(truth, CENTRES), [-50.0, -70.0, -100.0, -99.0, -100.0, -65.0]
    )
    assert truth.floor_dbm == -100.0
    assert np.isnan(GAINS[0, 2])


def test_what_is_at_the_floor_is_censored():
    """Only that; positions and powers are those measured."""
    found = measure(raster_truth(MAP, 30.0, -130.0, None, np.random.default_rng(0)), CENTRES)
    np.testing.assert_array_equal(found.censored, [False, False, True, False, True, False])
    np.testing.assert_array_equal(found.positions_m, CENTRES)
    assert found.power_dbm[2] == -100.0


def test_power_is_read_at_the_nearest_cell():
    """A place within a cell has the cell's value."""
    truth = raster_truth(MAP, 30.0, -130.0, None, np.random.default_rng(0))
    assert true_power_dbm(truth, np.array([[2.9, 10.4]]))[0] == -70.0


def test_a_place_keeps_its_fading():
    """The same seed gives the same field; another seed another; asking twice changes nothing."""
    one, again, other = (
        raster_truth(MAP, 30.0, -130.0, Rician(10.0), np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    first = true_power_dbm(one, CENTRES)
    np.testing.assert_array_equal(first, true_power_dbm(one, CENTRES))
    np.testing.assert_array_equal(first, true_power_dbm(again, CENTRES))
    assert (first != true_power_dbm(other, CENTRES)).any()
    assert first[0] != -50.0


def test_fading_comes_before_the_floor():
    """Gains just below the floor rise above it in some places, and none falls under it."""
    wide = Raster(np.arange(100.0), np.arange(100.0), np.full((100, 100), -130.5))
    truth = raster_truth(wide, 0.0, -130.0, Rician(10.0), np.random.default_rng(3))
    assert truth.raster.values.min() == -130.0
    assert 0.2 < (truth.raster.values > -130.0).mean() < 0.6


@pytest.mark.parametrize("floor", [None, -100.0])
def test_model_truth_is_the_model(floor):
    """Residuals after path loss have the model's variance; the floor clips and censors."""
    bounds = (0.0, 0.0, 401.0, 300.0)
    truth = model_truth(PARAMETERS, bounds, 4.0, floor, np.random.default_rng(5))
    assert truth.raster.values.shape == (75, 101)
    assert truth.raster.x_m[0] == 2.0
    assert truth.raster.y_m[-1] == 298.0
    xx, yy = np.meshgrid(truth.raster.x_m, truth.raster.y_m)
    centres = np.column_stack([xx.ravel(), yy.ravel()])
    found = measure(truth, centres)
    if floor is None:
        residual = found.power_dbm - regressors(centres, PARAMETERS.station) @ [-40.0, 3.0]
        assert residual.std() == pytest.approx(np.sqrt(29.0), rel=0.15)
        neighbours = np.diff(residual.reshape(75, 101), axis=1)
        expected = 2.0 * (25.0 * (1.0 - np.exp(-4.0 / 20.0)) + 4.0)
        assert neighbours.var() == pytest.approx(expected, rel=0.1)
        assert not found.censored.any()
    else:
        assert found.power_dbm.min() == floor
        np.testing.assert_array_equal(found.censored, found.power_dbm == floor)
        free = model_truth(PARAMETERS, bounds, 4.0, None, np.random.default_rng(5))
        np.testing.assert_array_equal(np.maximum(free.raster.values, floor), truth.raster.values)


def test_model_truth_of_another_multipath():
    """The same shadowing; what differs has the law's deviation, and its skewness to the left."""
    bounds = (0.0, 0.0, 400.0, 400.0)
    law = Nakagami(1.0)
    plain = model_truth(replace(PARAMETERS, multipath_std_db=0.0), bounds, 4.0, None, generator())
    faded = model_truth(PARAMETERS, bounds, 4.0, None, generator(), law)
    fading = (faded.raster.values - plain.raster.values).ravel()
    assert abs(fading.mean()) < 4.0 * law.std_db / 100.0
    assert fading.std() == pytest.approx(law.std_db, rel=0.05)
    assert ((fading / law.std_db) ** 3).mean() < -0.8


def generator():
    """The same each time."""
    return np.random.default_rng(8)
