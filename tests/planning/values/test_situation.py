"""What a step knows is asked for once: predictions by place, settings by term."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from terms_scene import TRACKING, situation_of, terms_problem

from planopt.planning.proof.context import search_prediction
from planopt.planning.values import context as module


def test_power_is_the_search_prediction_made_once(monkeypatch):
    """In any order, with repeats; only new places are predicted; another situation asks anew."""
    situation, _ = situation_of(terms_problem(TRACKING))
    places = np.random.default_rng(0).uniform(1.0, 39.0, (7, 2))
    asked = []

    def counted(law, new):
        asked.append(len(new))
        return search_prediction(law, new)

    monkeypatch.setattr(module, "search_prediction", counted)
    situation.power(places[:4])
    found = situation.power(places[[6, 0, 2, 5, 4]])
    situation.power(places)
    assert asked == [4, 3]
    expected = search_prediction(situation.law, places[[6, 0, 2, 5, 4]])
    np.testing.assert_allclose(found.mean_db, expected.mean_db, rtol=1e-12)
    np.testing.assert_allclose(found.deviation_db, expected.deviation_db, rtol=1e-12)
    replace(situation).power(places[:1])
    assert asked == [4, 3, 1]
    assert situation.power(places[:0]).mean_db.shape == (0,)


def test_tracking_settings_are_made_once_for_each_term():
    """The same object for a term, another for another."""
    situation, _ = situation_of(terms_problem(TRACKING, {**TRACKING, "sweet_spot_m": 3.0}))
    one, other = (term.settings(situation) for term in situation.problem.terms)
    assert situation.problem.terms[0].settings(situation) is one
    assert (one.sensor.sweet_spot_m, other.sensor.sweet_spot_m) == (1.0, 3.0)
