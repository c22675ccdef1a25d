"""When a closed loop ends."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import small_problem

from planopt import check, load, simulate
from planopt.extend import Rung
from planopt.planning.loop.ending import STALL_STEPS, goal_ending
from planopt.planning.loop.log import Outcome

PROBLEM = small_problem(max_steps=80)  # from (5, 15) to (35, 15), 2 m a step
PLAN = SimpleNamespace(rung=Rung.PLAN, message="")


def places(*x_m: float) -> list[np.ndarray]:
    """A track along y = 15."""
    return [np.array([x, 15.0]) for x in x_m]


def test_at_the_goal() -> None:
    """Within its radius, at the start and later."""
    assert goal_ending(PROBLEM, places(34.5), [], None) == (
        Outcome.REACHED,
        "the start is within goal_radius_m of the goal",
    )
    reached = goal_ending(PROBLEM, places(33.0, 34.0), [True], PLAN)
    assert reached == (Outcome.REACHED, "within goal_radius_m of the goal")


def test_on_the_way() -> None:
    """Nothing ends a run that moves."""
    assert goal_ending(PROBLEM, places(5.0), [], None) is None
    assert goal_ending(PROBLEM, places(5.0, 7.0), [False], PLAN) is None


@pytest.mark.parametrize("rung", list(Rung))
def test_waiting_is_no_stall(rung: Rung) -> None:
    """Who stands for some steps will lead on: going in circles makes plans direct."""
    plan = SimpleNamespace(rung=rung, message="cut off")
    assert (
        goal_ending(PROBLEM, places(*[7.0] * STALL_STEPS), [False] * (STALL_STEPS - 1), plan)
        is None
    )


def test_circling_is_a_stall() -> None:
    """Two longest steps about one place for `STALL_STEPS` steps, learning nothing."""
    track = places(*(5.0 + 3.0 * (k % 2) for k in range(STALL_STEPS + 1)))
    silent = [False] * STALL_STEPS
    outcome, reason = goal_ending(PROBLEM, track, silent, PLAN)
    assert outcome is Outcome.STALLED and reason.startswith("within 4 m of one place for 30 steps")
    assert goal_ending(PROBLEM, track[1:], silent[1:], PLAN) is None
    assert goal_ending(PROBLEM, track, [*silent[1:], True], PLAN) is None
    far = [np.array([11.0, 15.0]), *track[1:]]
    assert goal_ending(PROBLEM, far, silent, PLAN) is None


def test_no_more_steps() -> None:
    """The limit ends a run that is still on its way, but not one that has arrived by then."""
    problem = replace(PROBLEM, planner=replace(PROBLEM.planner, max_steps=1))
    assert goal_ending(problem, places(5.0), [], None) is None
    assert goal_ending(problem, places(5.0, 7.0), [True], PLAN) == (
        Outcome.STEP_LIMIT,
        "not arrived after 1 steps",
    )
    arrived = goal_ending(problem, places(33.0, 35.0), [True], PLAN)
    assert arrived is not None and arrived[0] is Outcome.REACHED


def test_a_run_of_no_step_is_saved_and_judged(tmp_path: Path) -> None:
    """Its table has the robot's state all the same."""
    problem = load("harbour_reach")
    robot = problem.robots[0]
    here = replace(robot, goal_m=robot.start_m, start_rest=(0.0, 0.0))
    problem = replace(problem, robots=(here,))
    simulation = simulate(problem)
    assert simulation.run.outcome is Outcome.REACHED
    assert simulation.plans == ((),)
    simulation.save(tmp_path)
    assert check(tmp_path).reasons == ()
