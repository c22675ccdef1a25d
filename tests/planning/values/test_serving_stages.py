"""Stages of several stations: value, gradient and Hessian by finite differences."""

from functools import cache

import numpy as np
import pytest

from planopt import Measurements
from planopt.channel import ChannelParameters, ChannelPosterior, Prediction, Station, condition
from planopt.channel.connectivity_law import ConnectivityLaw
from planopt.channel.kriging import LocalChannel, bound_quantile, connection_probability
from planopt.objectives.stage_power import ServingStages, StagePredictor, connectivity_derivatives
from planopt.planning.programme.goal_value import margins_of

PATH = np.array([[12.0, 9.0], [16.3, 11.2], [21.1, 13.0], [27.7, 12.1], [33.4, 8.2]])
P_MIN = 0.8
THRESHOLDS = (-62.0, -60.0)


@cache
def posterior(number: int) -> ChannelPosterior:
    """A channel known from sixty noisy places."""
    generator = np.random.default_rng(number)
    places = generator.uniform((0.0, 0.0), (40.0, 20.0), (60, 2))
    site = Station(((-5.0, 5.0), (45.0, 15.0))[number], 3.0)
    parameters = ChannelParameters(-28.0, 2.3, 5.0, 12.0, 1.5, site)
    distance = np.hypot(*(places - site.position_m).T)
    power = -28.0 - 23.0 * np.log10(distance) + generator.normal(scale=5.0, size=60)
    return condition(parameters, Measurements(places, power, np.zeros(60, dtype=bool)))


@pytest.fixture
def serving() -> ConnectivityLaw:
    return ConnectivityLaw((posterior(0), posterior(1)), THRESHOLDS, P_MIN)


def stages(serving: ConnectivityLaw) -> ServingStages:
    return ServingStages(serving.posteriors, serving.thresholds_dbm, serving.combined, PATH, 60)


def predicted(serving: ConnectivityLaw, places: np.ndarray) -> Prediction:
    """The law of what each station's own stages predict."""
    each = [
        StagePredictor(LocalChannel.around_each(posterior, PATH, 60))(places)
        for posterior in serving.posteriors
    ]
    return serving.combined([Prediction(mean.value, deviation.value) for mean, deviation in each])


def test_probabilities_are_exact_away_from_it(serving) -> None:
    """And so are the places that keep a bound."""
    places = PATH + np.array([1.7, -2.3])
    mean, deviation = stages(serving)(places)
    law = predicted(serving, places)
    found = connection_probability(mean.value, deviation.value, THRESHOLDS[0])
    expected = connection_probability(law.mean_db, law.deviation_db, THRESHOLDS[0])
    assert 0.03 < expected.min() < expected.max() < 1.0
    assert found == pytest.approx(expected, abs=1e-12)
    # Bounds are kept at the same places, whatever their level.
    for level in (0.3, 0.8, 0.95):
        kept = mean.value - bound_quantile(level) * deviation.value >= THRESHOLDS[0]
        assert (kept == (expected >= level)).all()


@pytest.mark.parametrize("what", ["margin", "chance"])
def test_derivatives_are_finite_differences(serving, what: str) -> None:
    predict, places, h = stages(serving), PATH + np.array([0.8, 0.5]), 1e-4

    def value(at: np.ndarray):
        power = predict(at)
        if what == "margin":
            return margins_of(*power, THRESHOLDS[0], 0.84)
        return connectivity_derivatives(*power, THRESHOLDS[0])

    here = value(places)
    for axis in (0, 1):
        step = h * np.eye(2)[axis]
        there, back = value(places + step), value(places - step)
        slope = (there.value - back.value) / (2.0 * h)
        assert here.gradient[:, axis] == pytest.approx(slope, rel=1e-5, abs=1e-7)
        bend = (there.gradient - back.gradient) / (2.0 * h)
        assert here.hessian[:, axis : axis + 2] == pytest.approx(bend, rel=1e-4, abs=1e-6)
