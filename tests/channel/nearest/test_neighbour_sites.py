"""Sites from neighbours against the joint ones."""

import numpy as np
import pytest

from planopt.channel import ChannelParameters, Measurements, Station
from planopt.channel.gaussian_sites import gaussian_sites
from planopt.channel.parameters import regressors
from planopt.channel.window_sites import SITE_BESIDE, neighbour_sites

PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))


def measured(count, share, seed=0, **more):
    """Random measurements about path loss, the weakest `share` at the receiver's floor."""
    generator = np.random.default_rng(seed)
    positions = generator.uniform(-100.0, 100.0, (count, 2))
    mean = regressors(positions, PARAMETERS.station) @ [PARAMETERS.k_pl_db, PARAMETERS.n_pl]
    power = mean + 6.0 * generator.standard_normal(count)
    floor = np.quantile(power, share)
    return Measurements(positions, np.maximum(power, floor), power <= floor, **more)


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_with_all_neighbours_they_are_the_joint_sites(share):
    """The same fixed point, to the tolerance of either."""
    data = measured(SITE_BESIDE + 1, share)
    found, joint = neighbour_sites(PARAMETERS, data), gaussian_sites(PARAMETERS, data)
    np.testing.assert_allclose(found.values_db, joint.values_db, atol=0.05)
    precision = 1.0 / joint.noise_variance_db2
    np.testing.assert_allclose(1.0 / found.noise_variance_db2, precision, rtol=1e-3, atol=1e-5)
    exact = ~data.censored
    np.testing.assert_array_equal(found.values_db[exact], data.power_dbm[exact])
    np.testing.assert_array_equal(found.noise_variance_db2[exact], 4.0)


def test_coarse_steps_and_position_errors_are_counted():
    """Rounded, displaced and by several receivers: still the joint sites."""
    generator = np.random.default_rng(1)
    data = measured(
        60,
        0.3,
        resolution_db=np.where(np.arange(60) % 2, 6.0, 0.0),
        position_std_m=generator.uniform(0.0, 5.0, 60),
        receiver=generator.integers(0, 3, 60),
    )
    found, joint = neighbour_sites(PARAMETERS, data), gaussian_sites(PARAMETERS, data)
    np.testing.assert_allclose(found.values_db, joint.values_db, atol=0.1)
    np.testing.assert_allclose(found.noise_variance_db2, joint.noise_variance_db2, rtol=0.02)


def test_close_to_the_joint_sites_for_many():
    """Of 700, what a site says is what the joint one says, in units of its own noise."""
    data = measured(700, 0.3)
    found, joint = neighbour_sites(PARAMETERS, data), gaussian_sites(PARAMETERS, data)
    off = (found.values_db - joint.values_db) / np.sqrt(joint.noise_variance_db2)
    assert 0.0 < np.abs(off).max() < 0.3
    assert np.sqrt(np.mean(off**2)) < 0.02


def test_many_limits_at_one_place():
    """More limits at one place than neighbours: none counts itself, all sites are the same."""
    data = Measurements(
        np.full((2 * SITE_BESIDE, 2), 20.0),
        np.full(2 * SITE_BESIDE, -110.0),
        np.ones(2 * SITE_BESIDE, dtype=bool),
    )
    found = neighbour_sites(PARAMETERS, data)
    np.testing.assert_allclose(found.values_db, found.values_db[0], rtol=1e-4)
    assert (found.noise_variance_db2 > 4.0).all()
