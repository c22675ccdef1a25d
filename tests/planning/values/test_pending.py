"""What the others of a team measure: values given theirs, against values of all together."""

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import CONNECT, ENERGY, LEARNING, TRACKING, context_of, terms_problem

from planopt.objectives.moments import posterior_moments
from planopt.objectives.terms.term import Pending
from planopt.planning.search.local_ranking import LocalRanking
from planopt.planning.values.local_value import local_value
from planopt.planning.values.objective_value import ObjectiveValue


def mapping(form):
    """A mapping term; with its threshold where the form has one."""
    term = {"kind": "mapping", "form": form}
    return term | ({"variance_threshold_db2": 2.0} if form == "path" else {})


COUNTING = [
    (LEARNING,),
    ({**LEARNING, "criterion": "T"},),
    ({**LEARNING, "criterion": "A"},),
    (mapping("information"),),
    (mapping("average"),),
    (mapping("path"),),
    (mapping("information"), {**CONNECT, "weight": 0.2}, ENERGY),
]


def paths(situation, count=3):
    """Paths of a few robots, side by side, that cross the same ground."""
    rng = np.random.default_rng(1)
    steps = np.array([0.9, 0.8]) + 0.1 * rng.normal(
        size=(count, situation.problem.planner.horizon, 2)
    )
    offset = 2.3 * np.arange(count)[:, None, None] * np.array([1.0, -1.0])
    return list(situation.position_m + offset + np.cumsum(steps, axis=1))


def beside(situation, *others, driven_m=None):
    driven = np.zeros((0, 2)) if driven_m is None else driven_m
    return replace(situation, aim=replace(situation.aim, pending=Pending(tuple(others), driven)))


def together(term, posterior, places, situation):
    """The value of all places as one set, from the first belief."""
    moments = posterior_moments(posterior, places, region=situation.near_region)
    return float(term.gain(situation, posterior).value(moments))


@pytest.mark.parametrize("form", ["information", "average", "T", "D", "A"])
def test_values_given_the_others_add_up(form):
    """F(1) + F(2 | 1) + F(3 | 1, 2) is F of all places together, far from each other."""
    term = mapping(form) if form in ("information", "average") else {**LEARNING, "criterion": form}
    situation, belief = context_of(terms_problem(term))
    first, second, third = paths(situation)
    added = (
        ObjectiveValue(situation)(first)
        + ObjectiveValue(beside(situation, first))(second)
        + ObjectiveValue(beside(situation, first, second))(third)
    )
    places = np.vstack([first, second, third])
    assert situation.measuring.takes(places[None]).all()
    whole = together(situation.problem.terms[0], belief.posterior, places, situation)
    assert added == pytest.approx(whole, rel=1e-7, abs=1e-9)


def test_anticipated_measurements_change_no_mean():
    """The predicted power, measured, leaves all predictions where they are, and surer."""
    situation, belief = context_of(terms_problem(mapping("information")))
    (found,) = beside(situation, *paths(situation)).anticipated
    places = situation.region.grid_m
    before, after = belief.posterior.predict(places), found.predict(places)
    np.testing.assert_allclose(after.mean_db, before.mean_db, atol=1e-6)
    assert (after.deviation_db <= before.deviation_db + 1e-9).all()
    assert (after.deviation_db < 0.98 * before.deviation_db).any()
    assert len(situation.posterior.measurements) == len(belief.posterior.measurements)


@pytest.mark.parametrize("stations", [1, 2])
@pytest.mark.parametrize("terms", COUNTING)
def test_searches_and_solvers_count_the_others(terms, stations):
    """Ranking and local worth agree with the exact worth, and derivatives with differences."""
    situation, _ = context_of(terms_problem(*terms, stations=stations))
    first, second, path = paths(situation)
    at = beside(situation, first, second)
    exact = ObjectiveValue(at)(path)
    assert exact != pytest.approx(ObjectiveValue(situation)(path), rel=1e-3)
    assert LocalRanking(at, path[None])(path[None])[0] == pytest.approx(exact, rel=0.1)
    evaluate, worth = local_value(at, path), ObjectiveValue(at)
    found = evaluate(path).value
    other = path[::-1] + 0.3
    assert found.value - evaluate(other).value.value == pytest.approx(
        exact - worth(other), rel=0.02, abs=0.01
    )
    rng = np.random.default_rng(2)
    for _ in range(3):
        towards, h = rng.normal(size=path.shape), 1e-5
        up, down = evaluate(path + h * towards).value, evaluate(path - h * towards).value
        slope = (up.value - down.value) / (2 * h)
        assert (found.gradient * towards).sum() == pytest.approx(slope, rel=1e-4, abs=1e-6)
        bend = (up.gradient - down.gradient) / (2 * h)
        along = found.hessian @ towards.ravel()
        np.testing.assert_allclose(along, bend.ravel(), rtol=1e-3, atol=1e-4 * abs(bend).max())


def test_packets_of_the_others_are_counted():
    """A second robot on the same path is worth less; far from the target it changes nothing."""
    situation, _ = context_of(terms_problem({**TRACKING, "form": "recourse"}))
    target = situation.aim.target_m
    alone = ObjectiveValue(situation)(target)
    assert 0.0 < ObjectiveValue(beside(situation, target))(target) < 0.999 * alone
    away = target + 1e5
    assert ObjectiveValue(beside(situation, away))(target) == pytest.approx(alone, rel=5e-3)
