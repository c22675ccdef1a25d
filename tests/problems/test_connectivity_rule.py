"""Rules and dynamics of a file that must fit together, and saving them."""

import pytest
from refusals import refused
from terms_scene import TABLES, TRACKING

from planopt import ConnectivityRule
from planopt.problems import problem_from_dict, problem_to_dict
from planopt.problems.problem import problem_from_tables

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
    del tables["robots"][0]["goal_m"], tables["constraints"]["p_min"]
    tables["problem"]["task"] = "learn"
    tables["objective"] = {"terms": [{"kind": "path_loss_learning"}]}
    return tables


def with_rule(tables, form, keys):
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


TRAM = {"name": "tram", "start_m": [30.0, 30.0], "velocity_m_s": [0.1, 0.0], "radius_m": 1.0}


def loaded(tmp_path, *robots, **constraints):
    tables = {
        **TABLES,
        "problem": {**TABLES["problem"], "task": "track"},
        "objective": {"terms": [TRACKING]},
        "targets": [{"start_m": [14.0, 18.0], "velocity_m_s": [0.9, 0.2]}],
        "robots": [
            {"name": f"r{number}", "speed_max_m_s": 2.0, **robot}
            for number, robot in enumerate(robots)
        ],
        "world": {**TABLES["world"], "moving": [TRAM]},
        "constraints": {**TABLES["constraints"], **constraints},
    }
    return problem_from_tables(tables, folder=tmp_path, file=None)


def heavy(x, y, *velocity):
    """A double integrator that takes 4 m to stop from full speed."""
    return {
        "start_m": [x, y],
        "dynamics": "double_integrator",
        "acceleration_max_m_s2": 0.5,
        "start_velocity_m_s": list(velocity),
    }


WHEELS = {"start_m": [12.0, 8.0], "dynamics": "unicycle", "turn_rate_max_rad_s": 1.0}


def test_robots_beside_each_other(tmp_path):
    """Every dynamics is allowed; two that follow each other stop apart, two that meet do not."""
    problem = loaded(tmp_path, heavy(5.0, 8.0, 0.0, 0.0), WHEELS, separation_m=3.0)
    assert problem.constraints.separation_m == 3.0
    assert len(problem.workspace.moving) == 1
    loaded(tmp_path, heavy(5.0, 8.0, 1.5, 0.0), heavy(9.0, 8.0, 1.5, 0.0), separation_m=3.5)
    with refused():
        loaded(tmp_path, heavy(5.0, 8.0, 1.5, 0.0), heavy(9.0, 8.0, -0.5, 0.0), separation_m=3.0)


@pytest.mark.parametrize("first", [True, False])
def test_robots_that_cannot_stop_apart_are_refused(tmp_path, first):
    """Wherever the fast one stands in the file, it is named."""
    robots = [heavy(5.0, 8.0, 2.0, 0.0), WHEELS]
    with refused() as caught:
        loaded(tmp_path, *(robots if first else robots[::-1]), separation_m=3.1)
    assert caught.value.key == f"robots[{0 if first else 1}].start_velocity_m_s"
    loaded(tmp_path, *robots, separation_m=3.0)
    loaded(tmp_path, heavy(5.0, 8.0, -0.5, 0.0), WHEELS, separation_m=3.0)
