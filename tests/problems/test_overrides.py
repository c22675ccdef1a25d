"""Single settings changed in a problem."""

import math
from dataclasses import replace
from functools import partial

import pytest
from refusals import refused

from planopt import ConnectivityRule, Constraints, Problem, Robot, load
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


def robot(problem: Problem, **changes) -> Problem:
    return replace(problem, robots=(replace(problem.robots[0], **changes), *problem.robots[1:]))


RULE = ConnectivityRule("joint", parameter_uncertainty="all")
TIMES = Constraints(p_min=0.5, rule=ConnectivityRule("each_step", (0.3,)))


@pytest.mark.parametrize(
    "make",
    [
        *(partial(with_overrides, load("open_field"), horizon=h) for h in (0, 501, -1)),
        *(
            partial(with_overrides, load("open_field"), planner=name)
            for name in ("magic", "one_step", "random", "lawnmower")
        ),
        partial(with_overrides, load("open_field"), cost_to_go="zero"),
        partial(with_overrides, replace(load("outdoor_track"), constraints=TIMES)),
        partial(
            with_overrides,
            robot(load("outdoor_track"), speed_max_m_s=1.0, dynamics=Unicycle(1.0, 0.6)),
            planner="random",
        ),
        # An error of the problem itself is not attributed to the override.
        partial(with_overrides, robot(load("open_field"), goal_m=None), horizon=7),
        lambda: Constraints(p_min=0.5, rule=ConnectivityRule("outage")),
        lambda: Constraints(p_min=0.5, rule=ConnectivityRule("data")),
        lambda: Constraints(p_min=0.5, rule=RULE),
        lambda: DRIVEN(start_rest=(float("nan"),)),
        lambda: DRIVEN(start_rest=(0.0, 0.0)),
    ],
)
def test_refused_overrides(make) -> None:
    """An override is checked like a file; the message says that the value is in none."""
    with refused() as caught:
        make()
    assert caught.value.file is None or "override" not in str(caught.value)


def test_inconsistent_copies() -> None:
    """Copies are checked before they are used: counts, names, areas, and what the task needs."""
    reach, track = load("open_field"), load("outdoor_track")
    for problem in (
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
        with refused():
            with_overrides(problem)
