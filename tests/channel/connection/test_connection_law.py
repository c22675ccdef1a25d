"""The calibrated law of connection: its probability, quantile, derivatives and normal stand-in."""

import numpy as np
import pytest
from scipy.special import expit
from scipy.stats import norm

from planopt.channel.connection.connection_law import NEUTRAL_SLOPE, ConnectionLaw
from planopt.channel.connection.serving_power import any_probability, serving_prediction
from planopt.channel.prediction import Prediction, bound_margin_db, connection_probability

SCORES = np.array([-60.0, -6.0, -1.3, 0.0, 0.4, 2.0, 7.0, 60.0])
LAWS = [ConnectionLaw(), ConnectionLaw(-0.7, 1.1), ConnectionLaw(0.4, 2.6)]
RAW = Prediction(
    np.array([-70.0, -84.0, -90.5, -97.0, np.nan]), np.array([8.0, 3.0, 0.0, 6.0, 4.0])
)
THRESHOLD_DBM = -90.0


@pytest.mark.parametrize("law", LAWS)
def test_probability_is_logistic(law):
    """Phi(h) is the logistic function of the score, far out as well, and rises with it."""
    logit = law.intercept + law.slope * SCORES
    h = law.normal_score(SCORES)
    np.testing.assert_allclose(norm.logcdf(h), -np.logaddexp(0.0, -logit), rtol=1e-12)
    np.testing.assert_allclose(norm.logsf(h), -np.logaddexp(0.0, logit), rtol=1e-12)
    assert (np.diff(h) > 0.0).all()


@pytest.mark.parametrize("law", LAWS)
def test_derivatives_by_differences(law):
    """First and second derivative of the normal score."""
    step = 1e-5
    h, first, second = law.normal_score_derivatives(SCORES)
    above, below = (law.normal_score_derivatives(SCORES + d) for d in (step, -step))
    np.testing.assert_array_equal(h, law.normal_score(SCORES))
    np.testing.assert_allclose(first, (above[0] - below[0]) / (2 * step), rtol=1e-7)
    np.testing.assert_allclose(second, (above[1] - below[1]) / (2 * step), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("p_min", [0.05, 0.5, 0.8, 0.999])
def test_quantile_and_probability_agree(law, p_min):
    """At the quantile of p_min the probability is p_min."""
    assert norm.cdf(law.normal_score(np.array([law.quantile(p_min)]))) == pytest.approx(p_min)


def test_neutral_law_is_near_the_normal_one():
    """Nowhere further than 0.0095, as its slope promises, and with heavier tails."""
    scores = np.linspace(-6.0, 6.0, 2001)
    apart = norm.cdf(ConnectionLaw().normal_score(scores)) - norm.cdf(scores)
    assert np.abs(apart).max() < 0.0095
    assert (apart[scores < -3.0] > 0.0).all() and (apart[scores > 3.0] < 0.0).all()
    assert ConnectionLaw().slope == NEUTRAL_SLOPE


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("p_min", [0.0, 0.3, 0.8, 0.99])
def test_stand_in_keeps_probability_and_margin(law, p_min):
    """The normal law that stands for it: same P, same margin in dB at p_min."""
    found = law.prediction(RAW, THRESHOLD_DBM, p_min)
    deviation = np.maximum(RAW.deviation_db, 1e-2)
    logit = law.intercept + law.slope * (RAW.mean_db - THRESHOLD_DBM) / deviation
    np.testing.assert_allclose(
        connection_probability(found.mean_db, found.deviation_db, THRESHOLD_DBM),
        expit(logit),
        rtol=1e-9,
    )
    assert np.isnan(found.mean_db[-1]) and (found.deviation_db[:-1] > 0.0).all()
    if p_min:
        np.testing.assert_allclose(
            bound_margin_db(found.mean_db, found.deviation_db, THRESHOLD_DBM, p_min),
            RAW.mean_db - law.quantile(p_min) * deviation - THRESHOLD_DBM,
            rtol=1e-9,
        )


def test_stand_in_at_the_quantile_itself():
    """Where the margin is zero the secant has no length: the slope serves, without a warning."""
    law = LAWS[1]
    mean = THRESHOLD_DBM + 5.0 * (law.quantile(0.8) + np.array([0.0, 1e-12, 1e-5]))
    found = law.prediction(Prediction(mean, np.full(3, 5.0)), THRESHOLD_DBM, 0.8)
    assert np.ptp(found.deviation_db) < 1e-4 * found.deviation_db[0]


def test_a_calibrated_station_among_others():
    """P(any) multiplies what each law leaves open; slack lowers all thresholds."""
    thresholds = (-90.0, -80.0)
    each = [
        Prediction(np.array([-85.0, -93.0]), np.array([6.0, 4.0])),
        Prediction(np.array([-88.0, -75.0]), np.array([5.0, 7.0])),
    ]
    laws = (LAWS[1], None)
    for slack in (0.0, 2.5):
        own = expit(-0.7 + 1.1 * (each[0].mean_db + slack + 90.0) / each[0].deviation_db)
        other = norm.cdf((each[1].mean_db + slack + 80.0) / each[1].deviation_db)
        found = any_probability(each, thresholds, slack, laws)
        np.testing.assert_allclose(found, 1.0 - (1.0 - own) * (1.0 - other), rtol=1e-12)
    joint = serving_prediction(each, thresholds, 0.8, laws)
    np.testing.assert_allclose(
        connection_probability(joint.mean_db, joint.deviation_db, thresholds[0]),
        any_probability(each, thresholds, 0.0, laws),
        rtol=1e-9,
    )
