"""A problem made in Python, which no schema has seen, is held to what a file is."""

from __future__ import annotations

from dataclasses import replace

from pydantic import ValidationError

from planopt.errors import InputError, require_text
from planopt.problems.check_motion import check_dynamics
from planopt.problems.checks import check
from planopt.problems.messages import input_error
from planopt.problems.problem import Problem, TermsObjective
from planopt.problems.robot import Robot
from planopt.problems.save import problem_to_dict
from planopt.problems.schema import ProblemFile
from planopt.robots.double_integrator import DoubleIntegrator
from planopt.robots.unicycle import Unicycle
from planopt.world.footprints import check_name
from planopt.world.workspace import Obstacle


def check_problem(problem: Problem) -> None:
    """Raise the first fault of a problem: of its tables, or of several of them together."""
    check_dynamics(problem)
    check_tables(problem)
    check(problem)


def check_tables(problem: Problem) -> None:
    """Raise the first fault of a problem's tables: types, ranges, what fits its task."""
    if isinstance(problem.objective, TermsObjective) and not problem.objective.terms:
        raise InputError("has no terms", key="objective.terms", remedy="one at least")
    for obstacle in (*problem.workspace.obstacles, *problem.workspace.timed):
        check_obstacle(obstacle)
    # Looked at above, and long.
    workspace = replace(problem.workspace, obstacles=(), timed=())
    robots = tuple(_in_files(robot) for robot in problem.robots)
    tables = problem_to_dict(replace(problem, workspace=workspace, robots=robots))
    try:
        ProblemFile.model_validate(tables)
    except ValidationError as error:
        raise input_error(error, ProblemFile, file=problem.file) from None
    require_text(problem.description, "the description")


def check_obstacle(obstacle: Obstacle) -> None:
    """Raise an InputError for an obstacle that no file could have."""
    key = "world.obstacles"
    check_name(obstacle.name)
    if not obstacle.polygon.is_valid or obstacle.polygon.area == 0.0:
        raise InputError(
            f"{obstacle.name} crosses itself or has no area",
            key=key,
            remedy="list the corners in order along the outline",
        )
    if not 0.0 <= obstacle.known_from_s < obstacle.until_s:
        raise InputError(
            f"{obstacle.name} is known from {obstacle.known_from_s!r} s until "
            f"{obstacle.until_s!r} s",
            key=key,
            remedy="give known_from_s from 0 on, and a larger until_s or none",
        )


def _in_files(robot: Robot) -> Robot:
    """The robot as a file can have it: dynamics from Python alone are checked elsewhere."""
    if isinstance(robot.dynamics, DoubleIntegrator | Unicycle | None):
        return robot
    return replace(robot, dynamics=None, start_rest=())
