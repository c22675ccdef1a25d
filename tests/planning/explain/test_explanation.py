"""What an explanation says to people."""

import pickle
from dataclasses import replace

import pytest
import shapely

import planopt
from planopt.planning.certificate import Relaxation


@pytest.mark.parametrize(
    ("key", "words"),
    [
        (
            "constraints.p_min",
            "constraints.p_min = 2 cannot be met at steps 1 to 2, 4, short by 3 dB",
        ),
        ("robots[0].speed_max_m_s", "robots[0].speed_max_m_s = 2 prevents a plan at steps 1 to 2"),
        (
            "planner.horizon",
            "planner.horizon = 2 prevents a plan at steps 1 to 2, 4, short by 3 dB",
        ),
    ],
)
def test_limits_stand_in_the_way(key, words):
    """What is asked for cannot be kept; nobody asks for a limit to be kept."""
    said = str(Relaxation(key, "", 2.0, (1, 2, 4), 3.0, "dB", 4.0, True, "robot"))
    assert said.startswith(words)
    assert said.endswith("; 4 would suffice (confirmed by solving again)")


def test_a_problem_whose_plan_is_verified_has_nothing_to_relax() -> None:
    """The text says so, and it is the same as of its solution."""
    problem = planopt.load("open_field")
    said = planopt.explain(problem)
    assert said == () == planopt.explain(planopt.solve(problem))
    assert str(said) == "Every plan is verified: it keeps all bounds."
    assert pickle.loads(pickle.dumps(said)).summary == said.summary


def test_a_problem_without_a_plan_says_what_would_open_a_way() -> None:
    """A wall across the workspace, which a smaller clearance does not open."""
    problem = planopt.load("open_field")
    _, y_min, _, y_max = problem.workspace.bounds_m
    middle = 0.5 * (problem.robots[0].start_m[0] + problem.goal_m[0])
    wall = planopt.Obstacle("wall", shapely.box(middle - 1.0, y_min, middle + 1.0, y_max))
    workspace = planopt.Workspace(problem.workspace.bounds_m, [wall])
    said = planopt.explain(replace(problem, workspace=workspace))
    assert [(one.value, one.verified) for one in said] == [(None, True)]
    assert str(said).startswith("There is no plan; each of these changes by itself would help")
