"""Single settings changed in a problem."""

from __future__ import annotations

from dataclasses import replace

import pytest

from planopt.errors import InputError
from planopt.problems.constraints import ConnectivityRule
from planopt.problems.load import load
from planopt.problems.overrides import with_overrides
from planopt.robots.unicycle import Unicycle


def test_only_the_named_settings_change() -> None:
    """The result is the problem with exactly these fields replaced."""
    problem = load("open_field")
    changed = with_overrides(problem, horizon=20, planner="lattice", cost_to_go="geodesic")
    assert changed == replace(
        problem,
        planner=replace(problem.planner, horizon=20, name="lattice"),
        objective=replace(problem.objective, cost_to_go="geodesic"),
    )


def test_nothing_named_nothing_changed() -> None:
    """Without settings the problem is as it was."""
    problem = load("open_field")
    assert with_overrides(problem) == problem


@pytest.mark.parametrize("horizon", [0, 501, 10_000, -1])
def test_horizon_out_of_range_has_the_error_of_the_file(horizon: int) -> None:
    """The range is the schema's; no file is named, since the value is in none."""
    with pytest.raises(InputError, match="should be at least 1 and at most 500") as caught:
        with_overrides(load("open_field"), horizon=horizon)
    assert caught.value.key == "planner.horizon"
    assert caught.value.file is None


def test_unknown_names_say_what_there_is() -> None:
    """A planner or cost to go that does not exist is answered with those that do."""
    with pytest.raises(InputError, match="'auto', 'nlp', 'scp', 'lattice'") as caught:
        with_overrides(load("open_field"), planner="magic")
    assert caught.value.key == "planner.name"
    with pytest.raises(InputError, match="'geodesic' or 'connected'") as caught:
        with_overrides(load("open_field"), cost_to_go="zero")
    assert caught.value.key == "objective.cost_to_go"


@pytest.mark.parametrize(
    ("rule", "key"),
    [
        (ConnectivityRule("outage"), "constraints"),
        (ConnectivityRule("data"), "constraints"),
        (ConnectivityRule("joint", parameter_uncertainty="all"), "constraints"),
        (ConnectivityRule("each_step", (0.3,)), "constraints.connected_times_s[0]"),
    ],
)
def test_a_rule_made_in_python_is_held_to_what_one_from_a_file_is(rule, key: str) -> None:
    """Incomplete rules, and keys that do not go together."""
    problem = load("outdoor_track")
    constraints = replace(problem.constraints, p_min=0.5, rule=rule)
    with pytest.raises(InputError) as caught:
        with_overrides(replace(problem, constraints=constraints))
    assert caught.value.key == key


@pytest.mark.parametrize(
    ("name", "rest", "key"),
    [
        ("outdoor_track", (float("nan"),), "robots[0]"),
        ("outdoor_track", (0.0, 0.0), "robots[0]"),
    ],
)
def test_dynamics_given_in_python_are_held_to_the_same(name: str, rest, key: str) -> None:
    """Nothing moves beside robots that drive curves; a start is a whole state."""
    problem = load(name)
    robots = tuple(
        replace(robot, dynamics=Unicycle(robot.speed_max_m_s, 0.6), start_rest=rest)
        for robot in problem.robots
    )
    with pytest.raises(InputError) as caught:
        with_overrides(replace(problem, robots=robots))
    assert caught.value.key == key


@pytest.mark.parametrize("planner", ["one_step", "random", "lawnmower"])
def test_planners_without_a_goal_are_not_for_reach(planner: str) -> None:
    """Neither in a file nor in its place."""
    with pytest.raises(InputError) as caught:
        with_overrides(load("open_field"), planner=planner)
    assert caught.value.key == "planner.name"


def test_an_error_of_an_override_says_so() -> None:
    """The value stands in no file, and the message says that it was given instead."""
    with pytest.raises(InputError, match="planner one_step was given in place") as caught:
        with_overrides(load("open_field"), planner="one_step")
    assert caught.value.file is None and caught.value.key == "planner.name"


def test_an_error_of_the_problem_itself_is_not_blamed_on_an_override() -> None:
    """A problem that would fail without the override fails with its own message."""
    problem = load("open_field")
    broken = replace(problem, robots=(replace(problem.robots[0], speed_max_m_s=-1.0),))
    with pytest.raises(InputError) as caught:
        with_overrides(broken, horizon=7)
    assert "given in place" not in str(caught.value)
