"""The score of any station: closed forms, both tails, finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import log_ndtr, ndtr

from planopt.channel.connectivity_law import any_score, any_score_derivatives


def scores(stations: int, places: int = 40, spread: float = 2.5) -> np.ndarray:
    """Seeded scores of stations at places."""
    return np.random.default_rng(stations).normal(scale=spread, size=(stations, places))


@pytest.mark.parametrize("stations", [1, 2, 3, 6])
def test_probability_is_that_of_independent_stations(stations: int) -> None:
    """Written out."""
    z = scores(stations)
    assert ndtr(any_score(z)) == pytest.approx(1.0 - np.prod(1.0 - ndtr(z), axis=0), abs=1e-14)


@pytest.mark.parametrize("z", [-900.0, -40.0, -9.0])
def test_low_tail_does_not_saturate(z: float) -> None:
    """Two stations as bad as each other double the probability, however small it is."""
    found = any_score(np.full((2, 1), z))[0]
    assert log_ndtr(found) == pytest.approx(log_ndtr(z) + np.log(2.0), rel=1e-11)


@pytest.mark.parametrize("z", [9.0, 40.0, 900.0])
def test_high_tail_does_not_saturate(z: float) -> None:
    """The probabilities of no connection multiply."""
    found = any_score(np.full((2, 1), z))[0]
    assert log_ndtr(-found) == pytest.approx(2.0 * log_ndtr(-z), rel=1e-11)


def test_it_is_at_least_the_best_and_grows_with_each() -> None:
    """A better station never hurts."""
    z = scores(3)
    found = any_score(z)
    assert (found >= z.max(axis=0)).all()
    for station in range(3):
        better = z.copy()
        better[station] += 0.1
        assert (any_score(better) > found).all()


def test_what_is_not_known_stays_so() -> None:
    """NaN stays NaN, in its own column."""
    found = any_score(np.array([[np.nan, 1.0], [0.5, 1.0]]))
    assert np.isnan(found[0]) and np.isfinite(found[1])


@pytest.mark.parametrize("spread", [0.5, 4.0])
def test_derivatives_are_finite_differences(spread: float) -> None:
    """Gradient and Hessian."""
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


def test_derivatives_in_the_tails() -> None:
    """Of two stations alike each has half of the effect where both are far below."""
    _, gradient, _ = any_score_derivatives(np.full((2, 1), -300.0))
    assert gradient[:, 0] == pytest.approx([0.5, 0.5], abs=1e-4)
    _, gradient, hessian = any_score_derivatives(np.array([[-300.0], [2.0]]))
    assert gradient[:, 0] == pytest.approx([0.0, 1.0])
    assert hessian[:, :, 0] == pytest.approx(np.zeros((2, 2)), abs=1e-12)
