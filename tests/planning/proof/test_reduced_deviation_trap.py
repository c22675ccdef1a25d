"""The trap of the reduced deviation: an open-loop plan must use today's (equation 3.2).

Measurements on the way will reduce the deviation at its end, but the mean there will change by what
they are, and nobody knows that today. A bound of 90 % asked with the reduced deviation is kept in
some 84 % of all channels. Fields are drawn from the prior, measured, predicted and planned for.
"""

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import binomtest

from planopt import Measurements
from planopt.channel import ChannelParameters, Station, condition, joint_prediction
from planopt.channel.kriging import bound_quantile

P_MIN, FIELDS, SEED = 0.9, 20_000, 41
MEASURED = np.array([[0.0, 0.0], [6.0, -5.0], [-8.0, 4.0]])
WAY = np.array([[16.0, 6.0], [24.0, 6.0]])
"""The next two steps; what is measured after the first tells much of the second."""
CHANNEL = ChannelParameters(
    k_pl_db=-40.0,
    n_pl=2.0,
    shadow_std_db=4.0,
    decorrelation_m=20.0,
    multipath_std_db=1.13,
    station=Station((-30.0, 0.0), 2.0),
)


def drawn_fields() -> np.ndarray:
    """Powers (FIELDS, 5) at the measured places and on the way, from the prior alone."""
    places = np.vstack([MEASURED, WAY])
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    covariance = 16.0 * np.exp(-apart / 20.0) + 1.13**2 * np.eye(5)
    away = np.sqrt(((places - np.array([-30.0, 0.0])) ** 2).sum(axis=1) + 4.0)
    mean = -40.0 - 20.0 * np.log10(away)
    normal = np.random.default_rng(SEED).standard_normal((FIELDS, 5))
    return mean + normal @ np.linalg.cholesky(covariance).T


def predicted_from(values_dbm: np.ndarray):
    """The prediction on the way from values measured."""
    measurements = Measurements(MEASURED, values_dbm, np.zeros(3, dtype=bool))
    return joint_prediction(condition(CHANNEL, measurements, theta="known"), WAY)


def kept_with(deviation_db: float) -> tuple[int, float, float]:
    """In how many fields the end is connected where the bound was just met with this deviation.

    The threshold of each field is that of the bound: mean less z_p deviations. With it the number
    of fields, and the 99 % interval of the probability.
    """
    fields = drawn_fields()
    # The mean is affine in what is measured.
    base = predicted_from(np.zeros(3)).mean_db[1]
    weight = [predicted_from(row).mean_db[1] - base for row in np.eye(3)]
    threshold = base + fields[:, :3] @ weight - bound_quantile(P_MIN) * deviation_db
    count = int((fields[:, 4] >= threshold).sum())
    interval = binomtest(count, FIELDS).proportion_ci(0.99)
    return count, interval.low, interval.high


def deviations() -> tuple[float, float]:
    """At the end of the way: today's deviation, and that after the first step's measurement."""
    covariance = predicted_from(np.zeros(3)).covariance_db2
    reduced = covariance[1, 1] - covariance[0, 1] ** 2 / covariance[0, 0]
    return float(np.sqrt(covariance[1, 1])), float(np.sqrt(reduced))


def test_todays_deviation_keeps_what_was_asked():
    """90 % lies within the interval of 20,000 fields."""
    today, _ = deviations()
    _, low, high = kept_with(today)
    assert low < P_MIN < high


def test_the_reduced_deviation_does_not():
    """Some 84 % of the fields instead of 90 %, as the closed form says."""
    today, reduced = deviations()
    promised = float(ndtr(bound_quantile(P_MIN) * reduced / today))
    count, low, high = kept_with(reduced)
    assert low < promised < high < P_MIN - 0.03
    assert count / FIELDS == pytest.approx(0.846, abs=0.015)
