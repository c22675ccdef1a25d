"""Scores, margins and serving power of several stations: closed forms, roots and draws."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import log_ndtr, ndtr

from planopt.channel import Prediction
from planopt.channel.connectivity_law import (
    any_probability,
    any_score,
    any_score_derivatives,
    serving_power_dbm,
    serving_prediction,
)
from planopt.channel.kriging import bound_margin_db, connection_probability


def scores(stations: int, places: int = 40, spread: float = 2.5) -> np.ndarray:
    return np.random.default_rng(stations).normal(scale=spread, size=(stations, places))


@pytest.mark.parametrize("stations", [1, 2, 3, 6])
def test_probability_is_that_of_independent_stations(stations: int) -> None:
    z = scores(stations)
    assert ndtr(any_score(z)) == pytest.approx(1.0 - np.prod(1.0 - ndtr(z), axis=0), abs=1e-14)


@pytest.mark.parametrize("z", [-900.0, -40.0, -9.0, 9.0, 40.0, 900.0])
def test_tails_do_not_saturate(z: float) -> None:
    """Two equal stations double a small probability, and square that of no connection."""
    found = any_score(np.full((2, 1), z))[0]
    if z < 0.0:
        assert log_ndtr(found) == pytest.approx(log_ndtr(z) + np.log(2.0), rel=1e-11)
    else:
        assert log_ndtr(-found) == pytest.approx(2.0 * log_ndtr(-z), rel=1e-11)


def test_what_is_not_known_stays_so() -> None:
    found = any_score(np.array([[np.nan, 1.0], [0.5, 1.0]]))
    assert np.isnan(found[0]) and np.isfinite(found[1])


@pytest.mark.parametrize("spread", [0.5, 4.0])
def test_derivatives_are_finite_differences(spread: float) -> None:
    z, h = scores(3, spread=spread), 1e-5
    value, gradient, hessian = any_score_derivatives(z)
    assert value == pytest.approx(any_score(z), rel=1e-13)
    assert hessian == pytest.approx(hessian.swapaxes(0, 1), abs=1e-9)
    for station in range(3):
        there, back = z.copy(), z.copy()
        there[station] += h
        back[station] -= h
        slope = (any_score(there) - any_score(back)) / (2.0 * h)
        assert gradient[station] == pytest.approx(slope, abs=1e-8)
        bend = (any_score_derivatives(there)[1] - any_score_derivatives(back)[1]) / (2.0 * h)
        assert hessian[:, station] == pytest.approx(bend, abs=1e-7)


THRESHOLDS = (-80.0, -76.0, -83.0)


def predictions(stations: int, places: int = 60) -> list[Prediction]:
    generator = np.random.default_rng(stations)
    return [
        Prediction(
            -80.0 + generator.normal(scale=8.0, size=places),
            np.exp(generator.normal(scale=0.5, size=places)) * 4.0,
        )
        for _ in range(stations)
    ]


def missed(each: list[Prediction], raised_db: float, place: int) -> float:
    """P(no station reaches its threshold, raised), written out."""
    return float(
        np.prod(
            [
                ndtr((t + raised_db - p.mean_db[place]) / p.deviation_db[place])
                for p, t in zip(each, THRESHOLDS, strict=False)
            ]
        )
    )


@pytest.mark.parametrize("stations", [2, 3])
@pytest.mark.parametrize("p_min", [0.0, 0.3, 0.9, 0.999])
def test_probability_at_the_first_threshold_is_that_of_any(stations: int, p_min: float) -> None:
    each = predictions(stations)
    law = serving_prediction(each, THRESHOLDS[:stations], p_min)
    found = connection_probability(law.mean_db, law.deviation_db, THRESHOLDS[0])
    expected = [1.0 - missed(each, 0.0, place) for place in range(60)]
    assert found == pytest.approx(expected, abs=1e-13)
    assert (law.deviation_db > 0.0).all()


@pytest.mark.parametrize("p_min", [0.3, 0.9, 0.999])
def test_margin_is_what_all_thresholds_may_be_raised_by(p_min: float) -> None:
    each = predictions(3)
    law = serving_prediction(each, THRESHOLDS, p_min)
    margin = bound_margin_db(law.mean_db, law.deviation_db, THRESHOLDS[0], p_min)
    for place in range(60):
        root = brentq(lambda m, k=place: 1.0 - missed(each, m, k) - p_min, -200.0, 200.0)
        assert margin[place] == pytest.approx(root, abs=1e-7)


def test_probability_against_draws() -> None:
    each = predictions(3, places=4)
    generator = np.random.default_rng(8)
    drawn = np.stack([generator.normal(p.mean_db, p.deviation_db, (10**6, 4)) for p in each])
    share = (serving_power_dbm(drawn, THRESHOLDS) >= THRESHOLDS[0]).mean(axis=0)
    assert any_probability(each, THRESHOLDS) == pytest.approx(share, abs=2.5e-3)
    lower = (serving_power_dbm(drawn, THRESHOLDS) >= THRESHOLDS[0] - 3.0).mean(axis=0)
    assert any_probability(each, THRESHOLDS, slack_db=3.0) == pytest.approx(lower, abs=2.5e-3)


def test_serving_power() -> None:
    """It reaches the first threshold where a station reaches its own; one alone stays as it is."""
    powers = np.array([[-81.0, -79.0, -90.0], [-75.0, -90.0, -90.0], [-90.0, -90.0, -83.5]])
    found = serving_power_dbm(powers, THRESHOLDS)
    assert found == pytest.approx([-79.0, -79.0, -80.5])
    connected = (powers >= np.array(THRESHOLDS)[:, None]).any(axis=0)
    assert ((found >= THRESHOLDS[0]) == connected).all()
    (alone,) = predictions(1)
    law = serving_prediction([alone], THRESHOLDS[:1], 0.9)
    assert law is alone
    powers = np.array([[-70.0, -90.0]])
    assert (serving_power_dbm(powers, THRESHOLDS[:1]) == powers[0]).all()


def test_power_that_is_known_exactly_decides() -> None:
    sure = Prediction(np.array([-70.0, -90.0]), np.zeros(2))
    other = Prediction(np.array([-95.0, -95.0]), np.full(2, 3.0))
    law = serving_prediction([sure, other], (-80.0, -80.0), 0.9)
    found = connection_probability(law.mean_db, law.deviation_db, -80.0)
    assert found == pytest.approx([1.0, ndtr(-5.0)], abs=1e-12)
    margin = bound_margin_db(law.mean_db, law.deviation_db, -80.0, 0.9)
    assert margin[0] == pytest.approx(10.0, abs=0.02)
