"""The keys of each rule of connectivity: what fits together, and that saving keeps them."""

from __future__ import annotations

import pytest

from planopt.errors import InputError
from planopt.problems.constraints import ConnectivityRule
from planopt.problems.save import problem_from_dict, problem_to_dict

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


@pytest.mark.parametrize(
    ("form", "keys", "words"),
    [
        ("average", {"p_min": 0.9, "outage_max_m": 3.0}, "outage_max_m, which goes only with"),
        ("each_step", {"p_min": 0.9, "deadline_s": 3.0}, "deadline_s, which goes only with"),
        ("joint", {}, "needs p_min above 0"),
        ("each_step", {"connected_times_s": [2]}, "needs p_min above 0"),
        ("outage", {"p_min": 0.9}, "needs one of outage_max_m and outage_max_s"),
        (
            "outage",
            {"p_min": 0.9, "outage_max_m": 3.0, "outage_max_s": 3.0},
            "needs one of outage_max_m and outage_max_s",
        ),
        ("data", {"data_mbit": 3.0, "deadline_s": 3.0}, "needs rate_mbit_s"),
        ("each_step", {"slack_max_db": 1.0}, "p_min is 0"),
        ("average", {"p_min": 0.9, "slack_price": 1.0}, "needs slack_max_db"),
        ("joint", {"p_min": 0.9, "parameter_uncertainty": "all"}, "not for connectivity"),
        ("each_step", {"parameter_uncertainty": "all"}, "p_min is 0"),
        ("sometimes", {"p_min": 0.9}, "each_step"),
        ("stated_times", {"p_min": 0.9, "connected_times_s": [0.5]}, "no multiple"),
        ("stated_times", {"p_min": 0.9, "connected_times_s": [-1.0]}, "greater than 0"),
        ("data", {**GOOD["data"], "data_mbit": float("inf")}, "finite"),
    ],
)
def test_keys_that_do_not_fit_are_refused(form, keys, words, learning, built):
    """With the table or key, and what is wrong."""
    with pytest.raises(InputError, match="constraints") as caught:
        built(with_rule(learning, form, keys))
    assert caught.value.remedy
    assert words in str(caught.value)


def test_reach_has_no_price_for_slack(tables, built):
    """It is refused at its key; slack without a price is not."""
    tables["constraints"] |= {"slack_max_db": 1.0}
    assert built(tables).constraints.rule.slack_max_db == 1.0
    tables["constraints"] |= {"slack_price": 1.0}
    with pytest.raises(InputError, match=r"constraints\.slack_price"):
        built(tables)


@pytest.mark.parametrize(
    ("keys", "key"),
    [({"p_min": 0.9999}, "constraints.p_min"), ({"data_mbit": 19.1}, "constraints.data_mbit")],
)
def test_data_that_no_plan_could_be_shown_to_deliver(keys, key, learning, built):
    """Drawn channels show 0.9995 at most; the link delivers its rate times the deadline at most."""
    built(with_rule(learning, "data", {**GOOD["data"], "p_min": 0.9995, "data_mbit": 19.0}))
    with pytest.raises(InputError) as caught:
        built(with_rule(learning, "data", {**GOOD["data"], **keys}))
    assert caught.value.key == key
