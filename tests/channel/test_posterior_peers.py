"""The posterior (equation 1.8) against scikit-learn and GSTools, to 1e-10 of the values.

Neither library has planopt's mean with an unknown theta built in. scikit-learn knows the mean, so
it is compared with theta known. GSTools takes the second regressor as a drift function beside its
own constant, which is universal kriging. Its ordinary kriging, a constant alone, has no
counterpart: a posterior here always has both regressors.
"""

import gstools
import numpy as np
import pytest
from simulated_channel import simulated
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Kernel, Matern, WhiteKernel

from planopt.channel import ChannelParameters, Station, condition, joint_prediction
from planopt.channel.measurements import join
from planopt.channel.parameters import regressors

CHANNELS = {
    "street": ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0)),
    "fig3": ChannelParameters(-10.0, 2.0, 4.0, 10.0, 1.99, Station((0.0, 0.0))),
    "little multipath": ChannelParameters(-30.0, 2.5, 8.0, 80.0, 0.3, Station((300.0, 90.0))),
}
SIDE_M = 200.0
AGREEMENT = 1e-10


@pytest.fixture(params=list(CHANNELS))
def channel(request):
    return CHANNELS[request.param]


@pytest.fixture(params=[3, 40, 300])
def data(channel, request):
    return simulated(channel, 1, request.param, SIDE_M)


def places(count=60):
    """Where to predict, also outside what was measured."""
    return np.random.default_rng(9).uniform(-0.2 * SIDE_M, 1.2 * SIDE_M, (count, 2))


def path_loss_dbm(channel, positions):
    return regressors(positions, channel.station) @ [channel.k_pl_db, channel.n_pl]


def shadow_kernel(channel) -> Kernel:
    """Covariance of shadowing, as scikit-learn has it."""
    return ConstantKernel(channel.shadow_std_db**2, "fixed") * Matern(
        channel.decorrelation_m, "fixed", nu=0.5
    )


def scikit_learn(channel, posterior, noise_db2=0.0):
    """Its regressor on what the posterior is conditioned on; `noise_db2` is of the places."""
    kernel = shadow_kernel(channel) + WhiteKernel(noise_db2, "fixed")
    known = posterior.measurements.positions_m
    oracle = GaussianProcessRegressor(
        kernel, alpha=posterior.noise_variance_db2 - noise_db2, optimizer=None
    )
    return oracle.fit(known, posterior.values_db - path_loss_dbm(channel, known))


def universal_kriging(channel, posterior):
    """GSTools' kriging on the same, with drift; it leaves multipath out of the variance."""
    model = gstools.Exponential(
        dim=2, var=channel.shadow_std_db**2, len_scale=channel.decorrelation_m, nugget=0.0
    )

    def drift(x, y):
        return regressors(np.stack([x, y], axis=-1), channel.station)[..., 1]

    return gstools.krige.Universal(
        model,
        posterior.measurements.positions_m.T,
        posterior.values_db,
        [drift],
        cond_err=posterior.noise_variance_db2,
        pseudo_inv=False,
    )


def assert_same(found, mean, variance_db2):
    """Mean and variance of a prediction to `AGREEMENT` of their values."""
    np.testing.assert_allclose(found.mean_db, mean, rtol=AGREEMENT)
    np.testing.assert_allclose(found.deviation_db**2, variance_db2, rtol=AGREEMENT)


@pytest.mark.parametrize("twice", [False, True])
def test_known_theta_is_scikit_learns(channel, data, twice):
    """Mean and deviation of a measured power; places measured twice have two multipath values."""
    once = simulated(channel, 3, 40, SIDE_M)
    posterior = condition(channel, join(once, once) if twice else data, theta="known")
    oracle = scikit_learn(channel, posterior, channel.multipath_std_db**2)
    mean, deviation = oracle.predict(places(), return_std=True)
    assert_same(posterior.predict(places()), mean + path_loss_dbm(channel, places()), deviation**2)


def test_joint_covariance_is_scikit_learns(channel, data):
    """Covariance of shadowing between all pairs of places."""
    posterior = condition(channel, data, theta="known")
    _, covariance = scikit_learn(channel, posterior).predict(places(), return_cov=True)
    np.testing.assert_allclose(
        joint_prediction(posterior, places(), latent=True).covariance_db2,
        covariance,
        atol=AGREEMENT * channel.shadow_std_db**2,
    )


def test_unknown_theta_is_gstools_universal_kriging(channel, data):
    """Mean and variance with both coefficients of path loss estimated."""
    posterior = condition(channel, data)
    mean, variance = universal_kriging(channel, posterior)(places().T)
    assert_same(posterior.predict(places()), mean, variance + channel.multipath_std_db**2)


def test_sites_and_updates_keep_to_the_peers(channel):
    """Censored measurements are kriging from their sites; measurements that came one by one."""
    whole = simulated(channel, 2, 60, SIDE_M, censored_share=0.2)
    posterior = condition(channel, whole.take(slice(40)))
    for index in range(40, 60):
        posterior = posterior.extend(whole.take(slice(index, index + 1)))
    mean, variance = universal_kriging(channel, posterior)(places().T)
    assert_same(posterior.predict(places()), mean, variance + channel.multipath_std_db**2)
