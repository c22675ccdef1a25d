"""Error of the posterior with wrong parameters."""

from dataclasses import replace

import numpy as np
import pytest

from planopt.channel import (
    ChannelParameters,
    Measurements,
    Station,
    condition,
    mean_squared_error_db2,
    sensitivity_curves,
)
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameter_uncertainty import perturbed
from planopt.channel.parameters import regressors

TRUE = ChannelParameters(-10.0, 2.0, 4.0, 8.0, 1.5, Station((12.0, 9.0), 2.0))
WRONG = ChannelParameters(-13.0, 2.4, 5.5, 4.0, 2.5, TRUE.station)
MEASURED = np.random.default_rng(1).uniform(0.0, 30.0, (25, 2))
PLACES = np.random.default_rng(2).uniform(0.0, 30.0, (40, 2))


def path_loss(parameters, places):
    return regressors(places, parameters.station) @ [parameters.k_pl_db, parameters.n_pl]


def predicted(assumed, power):
    """The posterior with known theta at the places (equation 1.6)."""
    data = Measurements(MEASURED, power, np.zeros(len(power), dtype=bool))
    return condition(assumed, data, theta="known").predict(PLACES)


@pytest.mark.parametrize(
    "assumed",
    [WRONG, replace(WRONG, station=Station((15.0, 5.0), 0.0)), replace(TRUE, n_pl=2.2)],
    ids=["all", "station", "n_pl"],
)
def test_simulation(assumed):
    """The squared error of the posterior's mean over fields of the true channel, to 5 sigma."""
    everywhere = np.concatenate([MEASURED, PLACES])
    covariance = shadow_covariance_db2(everywhere, everywhere, TRUE)
    covariance += TRUE.multipath_std_db**2 * np.eye(len(everywhere))
    draws = 4000
    power = path_loss(TRUE, everywhere)[:, None] + np.linalg.cholesky(
        covariance
    ) @ np.random.default_rng(3).standard_normal((len(everywhere), draws))
    # The posterior mean is affine in the data: its weights from unit measurements.
    constant = predicted(assumed, np.zeros(25)).mean_db
    weights = np.stack([predicted(assumed, row).mean_db - constant for row in np.eye(25)], axis=1)
    squares = (constant[:, None] + weights @ power[:25] - power[25:]) ** 2
    delta = mean_squared_error_db2(TRUE, assumed, MEASURED, PLACES)
    error = squares.std(axis=1) / np.sqrt(draws)
    assert (np.abs(squares.mean(axis=1) - delta) < 5.0 * error).all()


def test_no_error_is_the_posterior_variance():
    """With right parameters Delta^2 is the posterior variance."""
    deviation = predicted(TRUE, np.zeros(25)).deviation_db
    delta = mean_squared_error_db2(TRUE, TRUE, MEASURED, PLACES)
    np.testing.assert_allclose(delta, deviation**2, rtol=1e-10)


def test_curves_perturb_what_they_say():
    """Each curve's factor on the parameter it is named after."""
    for name, attribute, factor in [
        ("k_pl_db", "k_pl_db", 1.5),
        ("n_pl", "n_pl", 1.5),
        ("shadow_variance_db2", "shadow_std_db", np.sqrt(1.5)),
        ("decorrelation_m", "decorrelation_m", 1.5),
        ("multipath_std_db", "multipath_std_db", 1.5),
    ]:
        expected = replace(TRUE, **{attribute: getattr(TRUE, attribute) * factor})
        assert perturbed(TRUE, name, 0.5) == expected
        curve = sensitivity_curves(TRUE, MEASURED, PLACES, [0.5])[name]
        direct = mean_squared_error_db2(TRUE, expected, MEASURED, PLACES).mean()
        assert curve == pytest.approx([direct])
