"""What a problem must satisfy beyond the ranges of single keys.

These checks need geometry, or two tables at once. Each error carries the key to change.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely

from planopt.errors import InputError
from planopt.objectives.expression import START, WIDTHS, expression_values, names_in
from planopt.problems.channel_setup import (
    LoggedMeasurements,
    ModelTruth,
    RasterTruth,
    SampledMeasurements,
)
from planopt.problems.check_motion import check_stopping
from planopt.problems.objective import CasadiTerm
from planopt.problems.problem import Problem
from planopt.problems.rule_checks import check_rule
from planopt.world.clearance import (
    ObstacleIndex,
    clearance_m,
    containing_obstacle,
    index_obstacles,
    inside_bounds,
)
from planopt.world.moving_obstacle import centres_at
from planopt.world.raster_files import raster_ending

#: A drawn truth of more cells than this would not fit the memory of a small machine.
MAX_TRUTH_CELLS = 4_000_000


def check(problem: Problem) -> None:
    """Raise the first fault of `problem`.

    Raises
    ------
    InputError
        Bounds are reversed, a start or goal is out of bounds or too near to an obstacle, a robot
        cannot stop in time from its start, the
        channel's tables do not fit each other, or the truth would be too large.
    """
    _check_bounds(problem)
    index = index_obstacles(problem.workspace)
    for number, robot in enumerate(problem.robots):
        _check_place(problem, index, robot.start_m, f"robots[{number}].start_m")
        if robot.goal_m is not None:
            _check_place(problem, index, robot.goal_m, f"robots[{number}].goal_m")
        check_stopping(problem, index, number)
    _check_apart(problem)
    _check_channel(problem)
    check_rule(problem)
    for number, term in enumerate(problem.terms):
        if isinstance(term, CasadiTerm):
            _check_expression(problem, term, f"objective.terms[{number}]")


def _check_apart(problem: Problem) -> None:
    """Robots start apart from each other, and from where moving obstacles are at time 0."""
    separation = problem.constraints.separation_m
    _check_who_keeps_apart(problem)
    starts = np.array([robot.start_m for robot in problem.robots])
    for number, robot in enumerate(problem.robots):
        for other in range(number):
            distance = float(np.linalg.norm(starts[number] - starts[other]))
            if distance < separation:
                raise InputError(
                    f"is {list(robot.start_m)}, {distance:.3g} m from the start of "
                    f"{problem.robots[other].name}, less than the separation of {separation:g} m",
                    file=problem.file,
                    key=f"robots[{number}].start_m",
                    remedy="move it, or lessen constraints.separation_m",
                )
        for obstacle in problem.workspace.moving:
            centre = centres_at(obstacle, np.zeros(1))[0]
            distance = float(np.linalg.norm(starts[number] - centre)) - obstacle.radius_m
            if distance < problem.constraints.clearance_m:
                raise InputError(
                    f"is {list(robot.start_m)}, {distance:.3g} m from where the moving obstacle "
                    f"{obstacle.name} is at time 0, less than the clearance of "
                    f"{problem.constraints.clearance_m:g} m",
                    file=problem.file,
                    key=f"robots[{number}].start_m",
                    remedy="move it, or lessen constraints.clearance_m",
                )


def _check_who_keeps_apart(problem: Problem) -> None:
    """Distances at equal times are known of ways that are straight and even, not of others."""
    asked = "constraints.separation_m" if problem.constraints.separation_m else None
    asked = "world.moving" if problem.workspace.moving else asked
    for number, robot in enumerate(problem.robots):
        if asked is not None and robot.dynamics is not None:
            raise InputError(
                "is for robots that move straight and evenly in a step, which "
                f"robots[{number}] ({robot.name}) does not",
                file=problem.file,
                key=asked,
                remedy=f"leave it out, or use the dynamics single_integrator for {robot.name}",
            )


def check_files(problem: Problem) -> None:
    """Raise an error for a file that the problem needs for simulation and that is not there.

    Apart from :func:`check`, because a saved plan can be judged without these files.

    Raises
    ------
    InputError
        The truth's map or the log of measurements is not a file.
    """
    truth, measurements = problem.channel.truth, problem.channel.measurements
    if isinstance(truth, RasterTruth):
        _check_file(problem, truth.file, "channel.truth.file")
        try:
            raster_ending(truth.file)
        except InputError as error:
            raise InputError(
                error.message, file=problem.file, key="channel.truth.file", remedy=error.remedy
            ) from error
    if isinstance(measurements, LoggedMeasurements):
        _check_file(problem, measurements.file, "channel.measurements.file")


def _check_file(problem: Problem, path: Path, key: str) -> None:
    try:
        there = path.is_file()
    except OSError:  # a name that the file system does not allow
        there = False
    if not there:
        raise InputError(
            f"{path} is not a file",
            file=problem.file,
            key=key,
            remedy="file names are relative to the problem file",
        )


def _check_bounds(problem: Problem) -> None:
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    if not (x_min < x_max and y_min < y_max):
        raise InputError(
            f"is {list(problem.workspace.bounds_m)}, should have x_min < x_max and y_min < y_max",
            file=problem.file,
            key="world.bounds_m",
            remedy="[x_min, y_min, x_max, y_max]",
        )


def _check_place(
    problem: Problem, index: ObstacleIndex, place: tuple[float, float], key: str
) -> None:
    """A place where a robot must stand: in bounds and clear of every obstacle."""
    positions_m = np.array([place])
    if not inside_bounds(problem.workspace, positions_m).all():
        raise InputError(
            f"is {list(place)}, outside the bounds {list(problem.workspace.bounds_m)}",
            file=problem.file,
            key=key,
            remedy="move it, or widen world.bounds_m",
        )
    around = containing_obstacle(index, positions_m[0])
    if around is not None:
        raise InputError(
            f"is {list(place)}, inside the obstacle {around.name}",
            file=problem.file,
            key=key,
            remedy="move it",
        )
    distance = float(clearance_m(index, positions_m)[0])
    if distance < problem.constraints.clearance_m:
        nearest = index.obstacles[int(index.tree.nearest(shapely.Point(place)))]
        raise InputError(
            f"is {list(place)}, {distance:.3g} m from the obstacle {nearest.name}, less than "
            f"the clearance of {problem.constraints.clearance_m:g} m",
            file=problem.file,
            key=key,
            remedy="move it, or lessen constraints.clearance_m",
        )


def _check_expression(problem: Problem, term: CasadiTerm, key: str) -> None:
    """The instructions are some of an expression of as many steps as are planned."""
    steps = problem.planner.horizon
    if term.steps != steps:
        raise InputError(
            f"is {term.steps}, and planner.horizon is {steps}",
            file=problem.file,
            key=f"{key}.steps",
            remedy="write the term by planopt.casadi_term for this horizon",
        )
    nothing = {name: np.zeros((1, steps, width)) for name, width in WIDTHS.items()}
    try:
        expression_values(term.program, steps, nothing | {START: np.zeros((1, 1, 2))})
    except InputError as error:
        raise InputError(
            error.message, file=problem.file, key=f"{key}.{error.key}", remedy=error.remedy
        ) from None
    if "target_m" in names_in(term.program) and not problem.targets:
        raise InputError(
            "reads target_m, and there is no target",
            file=problem.file,
            key=f"{key}.program",
            remedy="add an entry of targets and a term of kind tracking, of weight 0 if need be",
        )


def _check_channel(problem: Problem) -> None:
    truth = problem.channel.truth
    if truth is None:
        if isinstance(problem.channel.measurements, SampledMeasurements):
            raise InputError(
                "measurements cannot be taken from a truth that is not given",
                file=problem.file,
                key="channel.measurements.count",
                remedy="add [channel.truth], or give the file of a log",
            )
        return
    if isinstance(truth, ModelTruth):
        x_min, y_min, x_max, y_max = problem.workspace.bounds_m
        cells = (x_max - x_min) / truth.cell_m * (y_max - y_min) / truth.cell_m
        if cells > MAX_TRUTH_CELLS:
            raise InputError(
                f"is {truth.cell_m:g}, which makes {cells:.3g} cells, "
                f"more than {MAX_TRUTH_CELLS:.3g}",
                file=problem.file,
                key="channel.truth.cell_m",
                remedy="larger cells, or smaller bounds",
            )
    for index, station in enumerate(problem.stations):
        if truth.floor_db is None:
            continue
        floor_dbm = station.transmit_power_dbm + truth.floor_db
        if floor_dbm >= station.threshold_dbm:
            raise InputError(
                f"is {station.threshold_dbm:g}, not above the receiver's floor of {floor_dbm:g} "
                "dBm, so that places without signal would count as connected",
                file=problem.file,
                key=f"stations[{index}].threshold_dbm",
                remedy="the floor is transmit_power_dbm + channel.truth.floor_db",
            )
