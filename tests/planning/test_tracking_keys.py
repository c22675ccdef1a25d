"""Keys of the term tracking: weights of steps, and what counts of the covariance."""

from __future__ import annotations

import numpy as np
import pytest
from terms_scene import TRACKING, judge_of, situation_of, terms_problem

from planopt.errors import InputError
from planopt.planning.plan import Verdict
from planopt.planning.planners import planner_for


def term_context(**keys):
    """A tracking term of these keys, and the situation of the small problem."""
    problem = terms_problem({**TRACKING, **keys}, horizon=4)
    return problem.terms[0], situation_of(problem)[0]


@pytest.mark.parametrize("form", ["additive", "sampled", "covariance", "information"])
def test_step_weights_multiply_steps(form):
    """Only the first step counts: the value of a path is that of its first step alone."""
    term, at = term_context(form=form, step_weights=[2.0, 0.0])
    plain, alone = term_context(form=form, step_weights=[1.0, 0.0])
    path = at.position_m + np.arange(1, 5)[:, None] * np.array([0.8, 0.3])
    assert term.value(at, path) == pytest.approx(2.0 * plain.value(alone, path), rel=1e-9)
    bent = path.copy()
    bent[1:] += 1.0
    assert plain.value(alone, bent) == pytest.approx(plain.value(alone, path), rel=0.05)
    np.testing.assert_array_equal(term.weights_of(4), [2.0, 0.0, 0.0, 0.0])


def test_a_terminal_weight_is_the_last_steps():
    """The last step of a plan counts so many times; of a single step that is all."""
    term, at = term_context(terminal_weight=3.0)
    plain, _ = term_context()
    path = at.position_m + np.arange(1, 5)[:, None] * np.array([0.8, 0.3])
    last, _ = term_context(step_weights=[0.0, 0.0, 0.0, 1.0])
    value = plain.value(at, path) + 2.0 * last.value(at, path)
    _, fresh = term_context()
    assert term.value(fresh, path) == pytest.approx(value, rel=1e-12)
    np.testing.assert_array_equal(term.weights_of(1), [3.0])


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"criterion": "determinant"}, "is no criterion of the form additive"),
        ({"step_weights": [0.0]}, "no step counts"),
        ({"step_weights": [-1.0]}, "step_weights"),
        ({"terminal_weight": 0.0}, "terminal_weight"),
        ({"criterion": "size", "form": "sampled"}, "criterion"),
    ],
)
def test_keys_that_do_not_fit_are_refused(keys, words):
    """With the key's name."""
    with pytest.raises(InputError, match=words):
        terms_problem({**TRACKING, **keys})


@pytest.mark.parametrize("criterion", ["determinant", "norm"])
def test_plans_of_every_criterion_are_verified(criterion):
    """The norm is half the trace, and has its plan; the solver climbs the determinant too."""
    found = {}
    for name in ("trace", criterion):
        problem = terms_problem({**TRACKING, "form": "sampled", "criterion": name}, horizon=3)
        situation, belief = situation_of(problem)
        judge, ground = judge_of(situation, belief)
        planner = planner_for(problem, ground, np.random.default_rng(0))
        found[name] = planner.plan(situation, judge)
        assert found[name].verdict is Verdict.VERIFIED
        assert found[name].objective >= found[name].lattice_objective - 1e-12
    if criterion == "norm":
        half = 0.5 * found["trace"].objective
        assert found["norm"].objective == pytest.approx(half, rel=0.02)
