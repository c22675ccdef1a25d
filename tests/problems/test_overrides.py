"""Single settings changed in a problem."""

import math
from dataclasses import replace
from functools import partial

import pytest
from refusals import refused

from planopt import ConnectivityRule, Constraints, InputError, Problem, Robot, load
from planopt.objectives import TermsObjective
from planopt.problems import Unicycle
from planopt.problems.load import with_overrides

DRIVEN = partial(
    Robot,
    start_m=(1.0, 1.0),
    speed_max_m_s=1.0,
    dynamics=Unicycle(speed_max_m_s=1.0, turn_rate_max_rad_s=0.6),
)


def test_only_the_named_settings_change() -> None:
    """The result is the problem with exactly these fields replaced."""
    problem = load("open_field")
    changed = with_overrides(problem, horizon=20, planner="lattice", cost_to_go="geodesic")
    assert changed == replace(
        problem,
        planner=replace(problem.planner, horizon=20, name="lattice"),
        objective=replace(problem.objective, cost_to_go="geodesic"),
    )


@pytest.mark.parametrize("horizon", [0, 501, 10_000, -1])
def test_horizon_out_of_range_has_the_error_of_the_file(horizon: int) -> None:
    """The range is the schema's; no file is named, since the value is in none."""
    with refused() as caught:
        with_overrides(load("open_field"), horizon=horizon)
    assert caught.value.key == "planner.horizon"
    assert caught.value.file is None


def test_unknown_names_say_what_there_is() -> None:
    """A planner or cost to go that does not exist is answered with those that do."""
    with refused() as caught:
        with_overrides(load("open_field"), planner="magic")
    assert caught.value.key == "planner.name"
    with refused() as caught:
        with_overrides(load("open_field"), cost_to_go="zero")
    assert caught.value.key == "objective.cost_to_go"


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: Constraints(p_min=0.5, rule=ConnectivityRule("outage")), "constraints"),
        (lambda: Constraints(p_min=0.5, rule=ConnectivityRule("data")), "constraints"),
        (
            lambda: Constraints(
                p_min=0.5, rule=ConnectivityRule("joint", parameter_uncertainty="all")
            ),
            "constraints",
        ),
        (
            lambda: with_overrides(
                replace(
                    load("outdoor_track"),
                    constraints=Constraints(p_min=0.5, rule=ConnectivityRule("each_step", (0.3,))),
                )
            ),
            "constraints.connected_times_s[0]",
        ),
        (lambda: DRIVEN(start_rest=(float("nan"),)), "robots[]"),
        (lambda: DRIVEN(start_rest=(0.0, 0.0)), "robots[]"),
    ],
)
def test_parts_made_in_python_are_held_to_what_a_file_is(make, key: str) -> None:
    """Incomplete rules, keys that do not go together, and a start that is no state."""
    with pytest.raises(InputError) as caught:
        make()
    assert caught.value.key == key


@pytest.mark.parametrize("planner", ["one_step", "random", "lawnmower"])
def test_planners_without_a_goal_are_not_for_reach(planner: str) -> None:
    """Neither in a file nor in its place."""
    with pytest.raises(InputError) as caught:
        with_overrides(load("open_field"), planner=planner)
    assert caught.value.key == "planner.name"


def test_planners_without_dynamics_are_not_for_robots_with_them() -> None:
    """An override is held to what a file is."""
    track = load("outdoor_track")
    robot = replace(track.robots[0], dynamics=Unicycle(1.0, 0.6))
    with refused():
        with_overrides(replace(track, robots=(robot,)), planner="random")


def test_an_error_of_an_override_says_so() -> None:
    """The value stands in no file, and the message says that it was given instead."""
    with refused() as caught:
        with_overrides(load("open_field"), planner="one_step")
    assert caught.value.file is None and caught.value.key == "planner.name"


def test_an_error_of_the_problem_itself_is_not_blamed_on_an_override() -> None:
    """A problem that would fail without the override fails with its own message."""
    problem = load("open_field")
    broken = replace(problem, robots=(replace(problem.robots[0], goal_m=None),))
    with pytest.raises(InputError) as caught:
        with_overrides(broken, horizon=7)
    assert "given in place" not in str(caught.value)


def robot(problem: Problem, **changes) -> Problem:
    return replace(problem, robots=(replace(problem.robots[0], **changes), *problem.robots[1:]))


def test_what_no_task_asks() -> None:
    """Copies are checked before they are used: counts, names, areas, and what the task needs."""
    reach, track = load("open_field"), load("outdoor_track")
    for problem in (
        robot(reach, goal_m=None),
        replace(reach, stations=()),
        replace(reach, robots=()),
        replace(reach, name="a/../b"),
        replace(reach, robots=reach.robots * 2),
        robot(track, goal_m=(1.0, 1.0)),
        replace(track, targets=()),
        replace(track, robots=track.robots * 2),
        replace(track, objective=TermsObjective((replace(track.terms[0], weight=math.nan),))),
        replace(track, objective=TermsObjective((replace(track.terms[0], form="sum"),))),
    ):
        with pytest.raises(InputError):
            with_overrides(problem)
