"""The worth that a solver sees: its derivatives, and how near it is to the exact worth."""

import casadi as ca
import numpy as np
import pytest
from terms_scene import (
    CONNECT,
    ENERGY,
    LEARNING,
    TRACKING,
    context_of,
    mapping,
    own_term,
    terms_problem,
)

from planopt.planning.values.context import structure_of
from planopt.planning.values.local_value import local_value
from planopt.planning.values.objective_value import ObjectiveValue


def everything(path):
    """An expression of one's own that reads all there is."""
    away = ca.sum2((path.positions_m - path.target_m) ** 2)
    drawn = path.connectivity * ca.exp(-away / 50.0) * path.deviation_db
    legs = ca.diff(ca.vertcat(path.start_m, path.positions_m))
    return ca.sum1(drawn) + 0.01 * path.mean_db[0] * path.mean_db[-1] - 0.1 * ca.sumsqr(legs)


SUMS = [
    (TRACKING,),
    (TRACKING, ENERGY),
    (CONNECT,),
    (own_term(everything), TRACKING),
    (mapping("two_layer"),),
    (LEARNING,),
    ({**LEARNING, "criterion": "T"},),
    ({**LEARNING, "criterion": "A"},),
    ({**LEARNING, "criterion": "V"},),
    (mapping("information"),),
    (mapping("path"),),
    (mapping("average"),),
    (TRACKING, {**LEARNING, "weight": 3.0}, {**ENERGY, "weight": 0.7}),
]


def connected(path):
    """An expression of what may be read of several stations."""
    away = ca.sum2((path.positions_m - path.target_m) ** 2)
    return ca.sum1(path.connectivity * ca.exp(-away / 50.0))


def with_stations(sums):
    """Each sum with one station, and with two where that can be."""
    for terms in sums:
        yield 1, terms
        if all(term.get("form") != "two_layer" and term["kind"] != "casadi" for term in terms):
            yield 2, terms
    yield 2, (own_term(connected), TRACKING)


def a_path(situation):
    """A path that does not stand still, with room for differences."""
    rng = np.random.default_rng(1)
    steps = np.array([0.9, 0.8]) + 0.3 * rng.normal(size=(situation.problem.planner.horizon, 2))
    return situation.position_m + np.cumsum(steps, axis=0)


def full(hessian, stages):
    if hessian.shape == (2 * stages, 2 * stages):
        return hessian
    matrix = np.zeros((2 * stages, 2 * stages))
    if hessian.ndim == 1:
        for k, block in enumerate(hessian[3 * stages :].reshape(-1, 2, 2)):
            matrix[2 * k : 2 * k + 2, 2 * k + 2 : 2 * k + 4] = block
            matrix[2 * k + 2 : 2 * k + 4, 2 * k : 2 * k + 2] = block.T
        hessian = hessian[: 3 * stages].reshape(-1, 3)
    for k, (xx, xy, yy) in enumerate(hessian):
        matrix[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[xx, xy], [xy, yy]]
    return matrix


@pytest.mark.parametrize(("stations", "terms"), list(with_stations(SUMS)))
@pytest.mark.parametrize("p_min", [0.0, 0.8])
def test_derivatives_are_those_of_the_value(stations, terms, p_min):
    """Gradient, Hessian and margins by central differences; stagewise sums have no cross terms."""
    problem = terms_problem(*terms, p_min=p_min, stations=stations)
    situation, _ = context_of(problem)
    path = a_path(situation)
    evaluate = local_value(situation, path)
    at = evaluate(path)
    n, step = len(path), 1e-4
    gradient, hessian = np.empty(2 * n), np.empty((2 * n, 2 * n))
    for i in range(2 * n):
        moved = np.zeros(2 * n)
        moved[i] = step
        more, less = (evaluate(path + sign * moved.reshape(n, 2)) for sign in (1, -1))
        gradient[i] = (more.value.value - less.value.value) / (2 * step)
        hessian[i] = (more.value.gradient - less.value.gradient).ravel() / (2 * step)
        if p_min:
            slope = (more.margins.value - less.margins.value) / (2 * step)
            assert slope[i // 2] == pytest.approx(at.margins.gradient.ravel()[i], abs=1e-6)
    scale = np.abs(gradient).max()
    np.testing.assert_allclose(at.value.gradient.ravel(), gradient, atol=1e-6 * scale)
    found = full(at.value.hessian, n)
    np.testing.assert_allclose(found, hessian, atol=1e-5 * max(np.abs(hessian).max(), scale))
    assert (at.margins is None) == (p_min == 0.0)
    shapes = {"stagewise": (n, 3), "chain": (7 * n - 4,), "full": (2 * n, 2 * n)}
    assert at.value.hessian.shape == shapes[structure_of(problem)]


@pytest.mark.parametrize(("stations", "terms"), list(with_stations(SUMS)))
def test_value_is_near_the_exact_worth(stations, terms):
    """With all 40 measurements near, only the rounded cusps are between them."""
    problem = terms_problem(*terms, stations=stations)
    situation, _ = context_of(problem)
    path, other = a_path(situation), a_path(situation)[::-1]
    evaluate, worth = local_value(situation, path), ObjectiveValue(situation)
    # Constants may differ: what a start costs is not a solver's matter.
    local = evaluate(path).value.value - evaluate(other).value.value
    exact = worth(path) - worth(other)
    assert local == pytest.approx(exact, rel=0.02, abs=0.02)
