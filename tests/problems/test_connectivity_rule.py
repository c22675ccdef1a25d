"""The keys of each rule of connectivity: what fits together, and that saving keeps them."""

from __future__ import annotations

import pytest

from planopt.problems import problem_from_dict, problem_to_dict
from planopt.problems.constraints import ConnectivityRule

GOOD = {
    "each_step": {"p_min": 0.9, "slack_max_db": 2.0, "parameter_uncertainty": "all"},
    "average": {"p_min": 0.9},
    "joint": {"p_min": 0.9, "slack_max_db": 1.5, "slack_price": 2.0},
    "outage": {"p_min": 0.9, "outage_max_s": 3.0},
    "data": {"data_mbit": 5.0, "deadline_s": 9.5, "rate_mbit_s": 2.0, "slack_max_db": 0.0},
    "stated_times": {"p_min": 0.9, "connected_times_s": [2, 7.0]},
}


@pytest.fixture
def learning(tables):
    """The tables of a problem that learns."""
    del tables["robots"][0]["goal_m"], tables["constraints"]["p_min"]
    tables["problem"]["task"] = "learn"
    tables["objective"] = {"terms": [{"kind": "path_loss_learning"}]}
    return tables


def with_rule(tables, form, keys):
    """The tables under a rule."""
    return {**tables, "constraints": {"connectivity": form, **keys}}


@pytest.mark.parametrize("form", GOOD)
def test_every_rule_is_read_and_saved(form, learning, built):
    """Each key arrives, and comes back from the saved problem."""
    problem = built(with_rule(learning, form, GOOD[form]))
    rule = problem.constraints.rule
    assert rule.connectivity == ("each_step" if form == "stated_times" else form)
    for key, value in GOOD[form].items():
        said = problem.constraints.p_min if key == "p_min" else getattr(rule, key)
        assert said == (tuple(value) if isinstance(value, list) else value)
    saved = problem_to_dict(problem)
    assert problem_from_dict(saved).constraints == problem.constraints


def test_plain_problems_say_nothing_of_rules(learning, built):
    """Files without a rule are saved as they always were."""
    problem = built(learning)
    assert problem.constraints.rule == ConnectivityRule()
    assert set(problem_to_dict(problem)["constraints"]) == {
        "p_min",
        "clearance_m",
        "goal_radius_m",
        "separation_m",
    }
