"""Keys of a robot's dynamics: what goes together, defaults, round trip."""

from __future__ import annotations

import json
from typing import Any

import pytest

from planopt.errors import InputError
from planopt.problems.load import load
from planopt.problems.overrides import with_overrides
from planopt.problems.save import problem_from_dict, problem_to_dict
from planopt.robots.double_integrator import DoubleIntegrator
from planopt.robots.unicycle import Unicycle

HEAVY = {"dynamics": "double_integrator", "acceleration_max_m_s2": 0.5}
WHEELS = {"dynamics": "unicycle", "turn_rate_max_rad_s": 1}


@pytest.fixture
def learn(tables: dict[str, Any]) -> dict[str, Any]:
    """The small tables with another task."""
    tables["problem"]["task"] = "learn"
    tables["objective"] = {"terms": [{"kind": "path_loss_learning"}]}
    del tables["robots"][0]["goal_m"]
    return tables


def test_defaults(learn, built) -> None:
    """At rest, heading along x, no driving backward; a single integrator without the keys."""
    assert built(learn).robots[0].dynamics is None
    assert built(learn).robots[0].start_state.tolist() == [5.0, 5.0]
    learn["robots"][0] |= HEAVY
    heavy = built(learn).robots[0]
    assert heavy.dynamics == DoubleIntegrator(1.0, 0.5)
    assert heavy.start_state.tolist() == [5.0, 5.0, 0.0, 0.0]
    learn["robots"] = [{"start_m": [5.0, 5.0], "speed_max_m_s": 1.0, **WHEELS}]
    wheels = built(learn).robots[0]
    assert wheels.dynamics == Unicycle(1.0, 1.0, 0.0)
    assert wheels.start_state.tolist() == [5.0, 5.0, 0.0]


@pytest.mark.parametrize(
    "keys",
    [
        {},
        HEAVY | {"start_velocity_m_s": [0.25, -0.5]},
        WHEELS | {"start_heading_rad": 2.5, "speed_min_m_s": -0.25},
    ],
)
def test_round_trip(learn, built, keys) -> None:
    """Through JSON, nothing is lost."""
    learn["robots"][0] |= keys
    problem = built(learn)
    again = problem_from_dict(json.loads(json.dumps(problem_to_dict(problem))))
    assert again.robots == problem.robots


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"dynamics": "double_integrator"}, "needs acceleration_max_m_s2"),
        ({"dynamics": "unicycle"}, "needs turn_rate_max_rad_s"),
        ({"acceleration_max_m_s2": 1.0}, "goes only with dynamics double_integrator"),
        ({"start_velocity_m_s": [0, 0]}, "goes only with dynamics double_integrator"),
        ({"start_heading_rad": 1.0}, "goes only with dynamics unicycle"),
        (HEAVY | {"turn_rate_max_rad_s": 1.0}, "goes only with dynamics unicycle"),
        (WHEELS | {"acceleration_max_m_s2": 1.0}, "goes only with dynamics double_integrator"),
        (HEAVY | {"start_velocity_m_s": [1.0, 0.1]}, "faster than speed_max_m_s"),
        (HEAVY | {"acceleration_max_m_s2": 0.0}, "more than 0"),
        (WHEELS | {"speed_min_m_s": 0.1}, "at most 0"),
        ({"dynamics": "bicycle"}, "single_integrator"),
    ],
)
def test_what_does_not_fit_is_refused(learn, built, keys, words: str) -> None:
    """With the robot's key and what it should be."""
    learn["robots"][0] |= keys
    with pytest.raises(InputError, match=words) as error:
        built(learn)
    assert error.value.remedy
    assert "robots[0]" in str(error.value)


@pytest.mark.parametrize(
    ("start", "velocity", "words"),
    [
        ([18.0, 15.0], [0.9, 0.0], "clear of the obstacles"),
        ([0.5, 5.0], [-0.9, 0.0], "within world.bounds_m"),
    ],
)
def test_a_start_from_which_it_cannot_stop_is_refused(learn, built, start, velocity, words) -> None:
    """In front of the hall, or of the border; the other way it is fine."""
    learn["robots"][0] |= HEAVY | {"start_m": start, "start_velocity_m_s": velocity}
    learn["robots"][0]["acceleration_max_m_s2"] = 0.3
    with pytest.raises(InputError, match=words) as error:
        built(learn)
    assert error.value.key == "robots[0].start_velocity_m_s"
    learn["robots"][0]["start_velocity_m_s"] = [-velocity[0], 0.0]
    assert built(learn).robots[0].start_rest == (-velocity[0], 0.0)


def test_a_goal_goes_with_any_dynamics(tables, built) -> None:
    """A robot that drifts on may have one."""
    tables["robots"][0] |= HEAVY
    assert built(tables).robots[0].dynamics is not None


@pytest.mark.parametrize("planner", ["one_step", "random", "lawnmower"])
def test_baselines_refuse(learn, built, planner: str) -> None:
    """In the file, and as an override."""
    learn["robots"][0] |= WHEELS
    problem = built(learn)
    with pytest.raises(InputError, match="is for robots of dynamics single_integrator"):
        with_overrides(problem, planner=planner)
    learn["planner"]["name"] = planner
    with pytest.raises(InputError, match="use auto, nlp, scp or lattice"):
        built(learn)


def test_more_than_a_circle_in_a_step_is_refused(learn, built) -> None:
    """There is nothing to plan, and formulas are exact up to there."""
    learn["planner"]["step_s"] = 2.0
    learn["robots"][0] |= WHEELS | {"turn_rate_max_rad_s": 3.14}
    assert built(learn).robots[0].dynamics == Unicycle(1.0, 3.14)
    learn["robots"][0]["turn_rate_max_rad_s"] = 3.15
    with pytest.raises(InputError, match="full circle"):
        built(learn)


def test_library_problems_have_single_integrators() -> None:
    """Files without the key are as they were."""
    assert load("outdoor_track").robots[0].dynamics is None
