"""A robot with dynamics that stands at its goal already."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from planopt import check, load
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.loop.log import Outcome


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
