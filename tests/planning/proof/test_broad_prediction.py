"""Bounds with all parameters uncertain: quantiles of mixtures, and plans that keep them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm
from terms_scene import TRACKING, terms_problem

from planopt import check, load
from planopt.channel.connectivity_law import UncertainParameters, mixture_quantile_dbm
from planopt.channel.parameter_uncertainty import marginalise
from planopt.channel.prediction import Prediction, bound_margin_db
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.plan import Verdict
from planopt.planning.proof.context import uncertain_law
from planopt.planning.solve import solve

SEED = 3


def all_uncertain(problem):
    """The problem with every parameter uncertain."""
    rule = replace(problem.constraints.rule, parameter_uncertainty="all")
    return replace(problem, constraints=replace(problem.constraints, rule=rule))


@pytest.mark.parametrize("p_min", [0.5, 0.9, 0.99])
def test_quantile_of_a_mixture(p_min):
    """The mixture's own distribution function says `p_min` there."""
    weights = np.array([0.5, 0.3, 0.2])
    parts = [
        Prediction(np.array([-60.0, -70.0]), np.array([3.0, 1.0])),
        Prediction(np.array([-62.0, -71.0]), np.array([5.0, 4.0])),
        Prediction(np.array([-55.0, -70.0]), np.array([8.0, 1.0])),
    ]
    found = mixture_quantile_dbm(weights, parts, p_min)
    above = sum(
        w * norm.sf(found, p.mean_db, p.deviation_db) for w, p in zip(weights, parts, strict=True)
    )
    np.testing.assert_allclose(above, p_min, atol=1e-12)


def test_quantile_where_parts_are_far_apart_or_certain():
    """Newton's method would leave such laws: bisection holds it, and no NaN comes of it."""
    weights = np.array([0.6, 0.4])
    parts = [
        Prediction(np.array([-90.0, -80.0, -80.0]), np.array([0.01, 0.0, 0.0])),
        Prediction(np.array([-30.0, -70.0, -70.0]), np.array([0.01, 3.0, 0.0])),
    ]
    found = mixture_quantile_dbm(weights, parts, 0.7)
    assert found[0] == pytest.approx(-90.0 + 0.01 * norm.isf(0.5), abs=1e-9)
    # The certain part counts whole at what it is, and not above.
    assert found[1:] == pytest.approx([-80.0, -80.0], abs=1e-6)


def test_margin_is_that_of_the_mixture():
    """At any place: zero margin where the mixture's chance of connection is p_min."""
    problem = all_uncertain(terms_problem(TRACKING, p_min=0.9))
    posterior = solve(problem, seed=SEED).belief.posterior
    law = uncertain_law(problem, [posterior])
    assert isinstance(law, UncertainParameters)
    places = np.random.default_rng(1).uniform(5.0, 35.0, (40, 2))
    power = law.power(places)
    marginal = marginalise(posterior.parameters, posterior.measurements)
    for place, mean, deviation in zip(places, power.mean_db, power.deviation_db, strict=True):
        threshold = float(bound_margin_db(mean, deviation, 0.0, 0.9))
        assert marginal.connectivity(place[None], threshold)[0] == pytest.approx(0.9, abs=1e-9)
    assert uncertain_law(terms_problem(TRACKING, p_min=0.9), [posterior]) is None


def test_plan_keeps_the_bound_of_the_mixture(tmp_path: Path):
    """Planned, driven and checked; where it binds the mixture's chance is p_min."""
    problem = all_uncertain(terms_problem(TRACKING, p_min=0.92, horizon=4, max_steps=3))
    solution = solve(problem, seed=SEED)
    plan, posterior = solution.plans[0], solution.belief.posterior
    assert plan.verdict is Verdict.VERIFIED
    marginal = marginalise(posterior.parameters, posterior.measurements)
    threshold = problem.stations[0].threshold_dbm
    chance = marginal.connectivity(plan.positions_m[1:], threshold)
    assert chance.min() >= 0.92 - 1e-7
    assert chance.min() < 0.925
    simulate(problem, seed=SEED).save(tmp_path)
    assert check(tmp_path).reasons == ()


def test_way_to_a_goal_with_all_parameters_uncertain(tmp_path: Path):
    """Driven for a few steps and checked from the files."""
    problem = load("open_field")
    problem = all_uncertain(
        replace(problem, planner=replace(problem.planner, max_steps=3, horizon=4))
    )
    driven = simulate(problem, seed=1)
    assert {plan.verdict for plan in driven.plans[0]} == {Verdict.VERIFIED}
    driven.save(tmp_path)
    assert check(tmp_path).reasons == ()


def test_what_is_possible_is_asked_of_the_mixture():
    """A step that is missed is excused by margins of the same law that it is missed by."""
    problem = all_uncertain(terms_problem(TRACKING, p_min=0.9))
    problem = replace(problem, robots=(replace(problem.robots[0], start_m=(37.0, 37.0)),))
    solution = solve(problem, seed=SEED)
    plan, posterior = solution.plans[0], solution.belief.posterior
    law = uncertain_law(problem, [posterior])
    assert law is not None
    certificate = plan.certificate
    assert certificate.relaxed_steps[0] == 1
    start = np.array([37.0, 37.0])
    grid = np.stack(np.meshgrid(*[np.linspace(-2.0, 2.0, 81)] * 2), axis=-1).reshape(-1, 2)
    places = start + grid[np.hypot(*grid.T) <= problem.step_length_m]
    power = law.power(places)
    margin = bound_margin_db(
        power.mean_db, power.deviation_db, problem.stations[0].threshold_dbm, 0.9
    )
    assert certificate.best_margin_db[0] == pytest.approx(margin.max(), abs=0.02)
