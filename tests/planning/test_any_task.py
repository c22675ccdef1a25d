"""One way to ask for every task."""

import pytest
from team_scene import two_trackers

import planopt


def test_the_answer_fits_the_task() -> None:
    """One robot to a goal, or a team."""
    reach = planopt.load("open_field")
    assert isinstance(planopt.solve(reach, horizon=2), planopt.Solution)
    solution = planopt.solve(two_trackers(), horizon=1, planner="one_step")
    assert isinstance(solution, planopt.Solution) and len(solution.plans) == 2
    assert solution.problem.planner.horizon == 1


def test_runs_fit_the_task() -> None:
    """Both count their steps."""
    steps: list[int] = []
    run = planopt.simulate(two_trackers(), planner="random", on_step=steps.append)
    assert isinstance(run, planopt.Run) and steps == [1, 2, 3]
    near = planopt.load("open_field")
    assert isinstance(planopt.simulate(near, planner="lattice", horizon=1), planopt.Run)


def test_there_is_no_cost_to_go_without_a_goal() -> None:
    """An error, not something ignored."""
    with pytest.raises(planopt.InputError, match="reach a goal"):
        planopt.solve(two_trackers(), cost_to_go="geodesic")
