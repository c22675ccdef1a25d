"""Beyond the exact limit: what was kept from earlier steps decides nothing."""

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import TRACKING, judge_of, situation_of, terms_problem

import planopt.planning.proof.predictions as predictions
import planopt.planning.proof.verify as verify
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import condition, extend
from planopt.channel.prediction import bound_margin_db
from planopt.planning.proof.verify import judge
from planopt.problems.problem import Problem

COUNT = 400


def known(problem: Problem, seed: int) -> Measurements:
    """Measurements all over the scene."""
    generator = np.random.default_rng(seed)
    places = generator.uniform(0.5, 39.5, (COUNT, 2))
    power = -25.0 - 8.0 * np.log10(np.linalg.norm(places - 4.0, axis=1) + 1.0)
    power += generator.normal(0.0, 3.0, COUNT)
    return Measurements(places, power, np.zeros(COUNT, dtype=bool))


@pytest.fixture
def small_limits(monkeypatch):
    """Groups of few neighbours, so that those that are kept and have grown differ."""
    monkeypatch.setattr(predictions, "EXACT_LIMIT", 50)
    monkeypatch.setattr(predictions, "NEIGHBOURS_BEYOND", 24)


def test_a_bound_on_the_edge_is_judged_as_by_anyone(small_limits, monkeypatch):
    """With thresholds at every step's margin, a posterior with a past judges as one without."""
    problem = terms_problem(TRACKING, p_min=0.8)
    situation, belief = situation_of(problem)
    measured = known(problem, 0)
    parameters = situation.posterior.parameters
    old = condition(parameters, measured.take(slice(COUNT - 40)), exact_limit=50)
    for step in range(COUNT - 40, COUNT):
        old = extend(old, measured.take(slice(step, step + 1)))
        predictions.certified_prediction(old, measured.positions_m[step] + np.ones((3, 2)))
    fresh = condition(parameters, measured, exact_limit=50)
    path = np.vstack(
        [situation.position_m, situation.position_m + [[1.0, 0.5], [2.0, 1.5], [3.0, 3.0]]]
    )
    kept, _ = predictions.certified_prediction(old, path)
    anew, kind = predictions.certified_prediction(fresh, path, keep=False)
    assert kind == "neighbours:24"
    apart = np.abs(kept.mean_db - anew.mean_db).max()
    assert apart > 1e-6
    monkeypatch.setattr(verify, "KEPT_ERROR_DB", 10.0 * apart)
    _, ground = judge_of(situation, belief)
    for margin in bound_margin_db(anew.mean_db, anew.deviation_db, 0.0, 0.8)[1:]:
        station = replace(problem.stations[0], threshold_dbm=float(margin))
        edge = replace(problem, stations=(station,))
        found = [
            judge(edge, ground.index, posterior, situation.position_m, path).certificate
            for posterior in (old, fresh)
        ]
        assert found[0].relaxed_steps == found[1].relaxed_steps
