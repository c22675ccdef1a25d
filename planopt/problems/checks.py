"""What a problem must satisfy beyond the ranges of single keys.

These checks need geometry, or two tables at once; each has a file of its own. Each error carries
the key to change.
"""

from __future__ import annotations

from planopt.errors import InputError
from planopt.objectives.terms.term import Term, TermSetting
from planopt.problems.check_apart import check_apart
from planopt.problems.check_calibration import check_calibration
from planopt.problems.check_channel import check_channel
from planopt.problems.check_motion import check_stopping
from planopt.problems.check_place import check_bounds, check_place
from planopt.problems.check_size import check_size
from planopt.problems.check_stations import check_stations
from planopt.problems.problem import Problem
from planopt.problems.rule_checks import check_rule
from planopt.world.clearance import index_obstacles

LEAST_STEP_M = 1e-3
"""Shorter steps are lost in the tolerances of planning."""


def check(problem: Problem) -> None:
    """Raise the first fault of `problem`.

    Raises
    ------
    InputError
        Bounds are reversed, a start or goal is out of bounds or too near to an obstacle, a robot
        cannot stop in time from its start or moves less than a millimetre in a step, the channel's
        tables do not fit each other, the truth or the lattice would be too large, or something is
        asked of several stations that is there for one only.
    """
    check_bounds(problem)
    index = index_obstacles(problem.workspace)
    for number, robot in enumerate(problem.robots):
        check_place(problem, index, robot.start_m, f"robots[{number}].start_m")
        if robot.goal_m is not None:
            check_place(problem, index, robot.goal_m, f"robots[{number}].goal_m")
        check_stopping(problem, index, number)
        _check_step(problem, number)
    check_apart(problem)
    check_channel(problem)
    check_stations(problem)
    check_calibration(problem)
    check_rule(problem)
    check_size(problem)
    for number, term in enumerate(problem.terms):
        _check_term(problem, term, f"objective.terms[{number}]")


def _check_term(problem: Problem, term: Term, key: str) -> None:
    """A term can be planned for in its problem."""
    setting = TermSetting(problem.planner.horizon, len(problem.stations), bool(problem.targets))
    try:
        term.check(setting)
    except InputError as error:
        raise InputError(
            error.message,
            file=problem.file,
            key=f"{key}.{error.key}" if error.key else key,
            remedy=error.remedy,
        ) from None


def _check_step(problem: Problem, number: int) -> None:
    """A step is long enough to be one."""
    speed_m_s = problem.robots[number].speed_max_m_s
    step_m = speed_m_s * problem.planner.step_s
    if step_m < LEAST_STEP_M:
        raise InputError(
            f"is {speed_m_s:g}, which makes steps of {step_m:.3g} m, less than {LEAST_STEP_M:g} m",
            file=problem.file,
            key=f"robots[{number}].speed_max_m_s",
            remedy="raise it, or planner.step_s",
        )
