"""The worth of several paths at once is that of each alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import ENERGY, LEARNING, TRACKING, situation_of, terms_problem

from planopt.planning.values import context as context_module
from planopt.planning.values.objective_value import ObjectiveValue

TERMS = {
    "tries": ({**TRACKING, "form": "recourse"},),
    "tries and energy": ({**TRACKING, "form": "recourse"}, ENERGY),
    "measurements": (LEARNING, ENERGY),
}


@pytest.fixture(params=TERMS.values(), ids=list(TERMS))
def step(request):
    """A situation, and random paths from where the robot is."""
    situation, _ = situation_of(terms_problem(*request.param, horizon=4))
    moves = np.random.default_rng(5).uniform(-1.2, 1.2, (5, 4, 2))
    return situation, list(situation.position_m + moves.cumsum(axis=1))


def test_several_paths_are_valued_as_each(step):
    """To the last bit in one situation, where a place has one prediction."""
    situation, paths = step
    worth = ObjectiveValue(situation)
    assert worth.of_each(paths) == [worth(path) for path in paths]
    alone = [ObjectiveValue(replace(situation))(path) for path in paths]
    np.testing.assert_allclose(worth.of_each(paths), alone, rtol=1e-9)


def test_several_paths_are_predicted_at_once(monkeypatch):
    """One call has the places of all of them; the other is for where retreats are."""
    situation, _ = situation_of(terms_problem(*TERMS["tries"], horizon=4))
    paths = list(situation.position_m + np.random.default_rng(6).uniform(-3, 3, (5, 4, 2)))
    asked: list[int] = []
    predict = context_module.search_prediction

    def counted(law, places):
        asked.append(len(places))
        return predict(law, places)

    monkeypatch.setattr(context_module, "search_prediction", counted)
    ObjectiveValue(situation).of_each(paths)
    assert asked[0] == 20 and len(asked) == 2
