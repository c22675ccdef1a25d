"""The value of a path to a goal: the documented cost, its derivatives, and who evaluates it."""

import numpy as np
import pytest
from reach_tasks import constant_margins, goal_nlp, outage_of, scored
from scipy.stats import norm

from planopt.arrays import Derivatives
from planopt.planning.programme.goal_value import (
    PIVOT_ROUNDING_M,
    STEP_ROUNDING_M,
    PricedCharge,
    ValueSource,
    remembering,
)

N = 4
START = np.array([0.3, -0.2])


def waves(positions_m):
    """Scores about zero, where the probability of connection bends most."""
    x, y = positions_m.T
    k = np.arange(1.0, len(x) + 1.0)
    sin, cos = np.sin(k * x), np.cos(k * x)
    return Derivatives(
        sin * np.cos(y),
        np.stack([k * cos * np.cos(y), -sin * np.sin(y)], axis=1),
        np.stack([-(k**2) * sin * np.cos(y), -k * cos * np.sin(y), -sin * np.cos(y)], axis=1),
    )


CHARGE = PricedCharge(
    np.array([5.0, 4.0]), 0.7, 1.3, **outage_of(N, 0.9, 0.6, [1.0, 0.0, 0.8, 1.0])
)


def cost(flat):
    q = np.vstack([START, flat.reshape(N, 2)])
    steps = np.linalg.norm(np.diff(q, axis=0), axis=1)
    share = np.append(0.6, CHARGE.charged * norm.sf(waves(q[1:]).value))
    outage = (np.hypot(steps, STEP_ROUNDING_M) * (share[:-1] + share[1:]) / 2.0).sum()
    to_pivot = np.hypot(np.linalg.norm(q[-1] - CHARGE.pivot_m), PIVOT_ROUNDING_M)
    return 0.7 * (steps**2).sum() + 1.3 * to_pivot + 0.9 * outage


def differences(function, x, h):
    steps = h * np.eye(len(x))
    return np.stack([(function(x + s) - function(x - s)) / (2.0 * h) for s in steps], axis=-1)


@pytest.mark.parametrize("stands", [False, True])
def test_cost_gradient_and_hessian(stands):
    """By differences; at a standstill the rounding keeps slope and curvature finite."""
    flat = np.tile(START, N) if stands else np.random.default_rng(4).standard_normal(2 * N)
    nlp = goal_nlp(N, 0)
    nlp.source.evaluate = scored(constant_margins(1.0), waves)
    parameters = np.concatenate([START, [1.0, 0.0, 1.0], CHARGE.numbers])

    def gradient(at):
        return nlp.functions.slopes(at, parameters)[0]

    assert nlp.functions.objective(flat, parameters) == pytest.approx(cost(flat), rel=1e-12)
    np.testing.assert_allclose(gradient(flat), differences(cost, flat, 1e-6), atol=1e-6)
    hessian = nlp.functions.hessian(flat, parameters, np.zeros(2 * N))
    np.testing.assert_allclose(hessian, differences(gradient, flat, 1e-6), atol=1e-4)


FLAT = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]).reshape(N, 2)


def test_a_point_is_computed_once():
    """The last bit of a coordinate is another point."""
    evaluated = []

    def counting(places_m):
        evaluated.append(places_m.copy())
        return scored(constant_margins(1.0))(places_m)

    with pytest.raises(AssertionError, match="before its value"):
        ValueSource()(FLAT)
    evaluate, place = remembering(counting), FLAT.copy()
    assert evaluate(FLAT) is evaluate(place)
    assert len(evaluated) == 1
    # The solver writes its iterates into one array: contents count, not identity.
    place[1, 1] = np.nextafter(4.0, 5.0)
    evaluate(place)
    assert len(evaluated) == 2
