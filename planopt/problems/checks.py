"""Consistency checks of a problem that involve geometry or several tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import islice, product
from typing import TYPE_CHECKING

import numpy as np
import shapely

from planopt.errors import InputError
from planopt.keys import LARGEST_COORDINATE_M
from planopt.parts import calling
from planopt.problems.channel_setup import (
    ArrayTruth,
    FittedTruth,
    FunctionTruth,
    LoggedMeasurements,
    MeasuredTruth,
    ModelTruth,
    RasterTruth,
    SampledMeasurements,
    log_of,
    raster_truth_of,
)
from planopt.robots.dynamics import RestsByInput, state_after, stopping_motion
from planopt.world.clearance import (
    ObstacleIndex,
    clearance_m,
    containing_obstacle,
    index_obstacles,
    inside_bounds,
)
from planopt.world.motion import CLOSE_M, centres_at, step_distances_m
from planopt.world.workspace import node_estimate

if TYPE_CHECKING:
    from planopt.problems.problem import Problem

CLEARANCE_TO_GOALS_M = 0.01
"""Extra distance between goals beyond the separation, because planners keep a small margin."""


def check_apart(problem: Problem) -> None:
    """Check the separation of robots from each other and from moving obstacles at the start."""
    separation = problem.constraints.separation_m
    starts = np.array([robot.start_m for robot in problem.robots])
    for number, robot in enumerate(problem.robots):
        for other in range(number):
            distance = float(np.linalg.norm(starts[number] - starts[other]))
            drawn = robot.start_spread_m + problem.robots[other].start_spread_m > 0.0
            if distance < separation and not drawn:
                raise InputError(
                    f"is {list(robot.start_m)}, only {distance:.3g} m from the start of "
                    f"robots[{other}]; the required separation is {separation:g} m",
                    key=f"robots[{number}].start_m",
                    remedy="move it, or reduce constraints.separation_m",
                )
            _check_goals_apart(problem, number, other)
            _check_stopping_apart(problem, number, other)
        for obstacle in problem.workspace.moving:
            centre = centres_at(obstacle, np.zeros(1))[0]
            distance = float(np.linalg.norm(starts[number] - centre)) - obstacle.radius_m
            if distance < problem.constraints.clearance_m:
                raise InputError(
                    f"is {list(robot.start_m)}, only {distance:.3g} m from the moving obstacle "
                    f'"{obstacle.name}" at time 0; the required clearance is '
                    f"{problem.constraints.clearance_m:g} m",
                    key=f"robots[{number}].start_m",
                    remedy="move it, or reduce constraints.clearance_m",
                )


def _check_goals_apart(problem: Problem, number: int, other: int) -> None:
    """Check that the goals of two robots keep the separation."""
    goal, others, separation = (
        problem.robots[number].goal_m,
        problem.robots[other].goal_m,
        problem.constraints.separation_m,
    )
    if goal is None or others is None or separation == 0.0:
        return
    distance = float(np.linalg.norm(np.subtract(goal, others)))
    if distance < separation + CLEARANCE_TO_GOALS_M:
        raise InputError(
            f"is {list(goal)}, only {distance:.3g} m from the goal of "
            f"robots[{other}]; the distance must exceed the separation of "
            f"{separation:g} m",
            key=f"robots[{number}].goal_m",
            remedy="move it, or reduce constraints.separation_m",
        )


def _check_stopping_apart(problem: Problem, number: int, other: int) -> None:
    """Check that two robots keep their separation while braking, so a safe plan always exists."""
    separation, step_s = problem.constraints.separation_m, problem.planner.step_s
    moving = {
        one: stopping_motion(robot.dynamics, robot.start_state, step_s)
        for one, robot in ((one, problem.robots[one]) for one in (number, other))
    }
    steps = max(motion.steps for motion in moving.values())
    if separation == 0.0 or steps == 0:
        return
    distance = float(step_distances_m(moving[number], moving[other], steps).min())
    if distance + CLOSE_M < separation:
        fast, slow = (number, other) if moving[number].steps else (other, number)
        raise InputError(
            f"is {list(problem.robots[fast].start_rest)}: even if it brakes at once, the robot "
            f"comes within {distance:.3g} m of {problem.robots[slow].name}; the required "
            f"separation is {separation:g} m",
            key=f"robots[{fast}].start_velocity_m_s",
            remedy="reduce the start velocity, start elsewhere, or reduce constraints.separation_m",
        )


MAX_TRUTH_CELLS = 4_000_000  # Maximum number of cells of a simulated ground truth, to limit memory


def check_channel(problem: Problem) -> None:
    """Check that measurements have a source and that receiver floors are below thresholds."""
    truth = problem.channel.truth
    measurements = problem.channel.measurements
    if truth is None:
        if isinstance(measurements, SampledMeasurements) and measurements.count > 0:
            raise InputError(
                "needs a ground truth to measure, but [channel.truth] is missing",
                key="channel.measurements.count",
                remedy="add [channel.truth], or name a log in channel.measurements.file",
            )
        return
    if isinstance(truth, ModelTruth | FittedTruth | MeasuredTruth | FunctionTruth):
        _check_cells(problem, truth.cell_m)
    sampled = isinstance(measurements, SampledMeasurements) and measurements.count > 0
    if isinstance(truth, FittedTruth) and sampled:
        raise InputError(
            'is "fitted", but there is no log to fit',
            key="channel.truth.kind",
            remedy="name a log in channel.measurements.file",
        )
    for index, station in enumerate(problem.stations):
        if isinstance(truth, ArrayTruth | FunctionTruth):
            floor_dbm, remedy = (
                truth.floor_dbm,
                "raise the threshold, or lower channel.truth.floor_dbm",
            )
        else:
            floor_db = None if isinstance(truth, MeasuredTruth) else truth.floor_db
            floor_dbm = None if floor_db is None else station.transmit_power_dbm + floor_db
            remedy = "raise the threshold, or lower channel.truth.floor_db"
        for key in ("threshold_dbm", "receive_threshold_dbm"):
            least_dbm = getattr(station, key)
            if floor_dbm is not None and least_dbm is not None and floor_dbm >= least_dbm:
                raise InputError(
                    f"is {least_dbm:g} dBm, not above the receiver's sensitivity of "
                    f"{floor_dbm:g} dBm: positions without signal would count as connected",
                    key=f"stations[{index}].{key}",
                    remedy=remedy,
                )


def _check_cells(problem: Problem, cell_m: float) -> None:
    """Raise `InputError` if the ground truth would have too many cells for the memory."""
    if not 0.0 < cell_m <= LARGEST_COORDINATE_M:
        raise InputError(
            f"is {cell_m!r}, should be above 0",
            key="channel.truth.cell_m",
            remedy="give the side of a cell in metres",
        )
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    cells = (x_max - x_min) / cell_m * (y_max - y_min) / cell_m
    if cells > MAX_TRUTH_CELLS:
        raise InputError(
            f"is {cell_m:g} m, which makes {cells:.3g} cells; at most {MAX_TRUTH_CELLS:.3g} "
            "are allowed",
            key="channel.truth.cell_m",
            remedy="give larger cells or smaller bounds",
        )


def check_place(
    problem: Problem, index: ObstacleIndex, place: tuple[float, float], key: str
) -> None:
    """Check that a robot position is within the bounds and keeps the clearance."""
    positions_m = np.array([place])
    if not inside_bounds(problem.workspace, positions_m).all():
        raise InputError(
            f"is {list(place)}, outside world.bounds_m = {list(problem.workspace.bounds_m)}",
            key=key,
            remedy="move it, or enlarge world.bounds_m",
        )
    around = containing_obstacle(index, positions_m[0])
    if around is not None:
        raise InputError(
            f'is {list(place)}, inside the obstacle "{around.name}"', key=key, remedy="move it"
        )
    distance = float(clearance_m(index, positions_m)[0])
    if distance < problem.constraints.clearance_m:
        nearest = index.obstacles[int(index.tree.nearest(shapely.Point(place)))]
        raise InputError(
            f'is {list(place)}, only {distance:.3g} m from the obstacle "{nearest.name}"; the '
            f"required clearance is {problem.constraints.clearance_m:g} m",
            key=key,
            remedy="move it, or reduce constraints.clearance_m",
        )


NODE_BYTES, STAGE_BYTES = 1700, 8
"""Measured memory in bytes per lattice node, and per node and stage of the horizon."""
LARGEST_LATTICE_BYTES = 4 * 10**9  # Memory limit in bytes for the lattices of all robots together


def check_size(problem: Problem) -> None:
    """Raise `InputError` if the lattice search would exceed the memory limit."""
    horizon = problem.planner.horizon
    nodes = sum(
        node_estimate(problem.workspace, robot.speed_max_m_s * problem.planner.step_s)
        for robot in problem.robots
    )
    needed = nodes * (NODE_BYTES + STAGE_BYTES * horizon)
    if needed > LARGEST_LATTICE_BYTES:
        raise InputError(
            f"is {problem.planner.step_s:g} s, for which the search lattice has {nodes:.2g} "
            f"nodes and needs {needed / 1e9:.2g} GB of memory at horizon {horizon}; at most "
            f"{LARGEST_LATTICE_BYTES / 1e9:g} GB are allowed",
            key="planner.step_s",
            remedy="increase the step, or reduce world.bounds_m or planner.horizon",
        )


LEAST_STEP_M = 1e-3  # Minimum step length in metres, above the tolerances of planning


def check(problem: Problem) -> None:
    """Raise an `InputError` for the first inconsistency of `problem`."""
    bounds_m = problem.workspace.bounds_m
    if not (bounds_m[0] < bounds_m[2] and bounds_m[1] < bounds_m[3]):
        raise InputError(
            f"is {list(bounds_m)}, should have x_min < x_max and y_min < y_max",
            key="world.bounds_m",
            remedy="give [x_min, y_min, x_max, y_max] in metres",
        )
    index = index_obstacles(problem.workspace)
    for number, robot in enumerate(problem.robots):
        key = f"robots[{number}]"
        check_place(problem, index, robot.start_m, f"{key}.start_m")
        if robot.goal_m is not None:
            check_place(problem, index, robot.goal_m, f"{key}.goal_m")
        check_own_map(problem, number)
        check_stopping(problem, index, number)
        step_m = robot.speed_max_m_s * problem.planner.step_s
        if step_m < LEAST_STEP_M:
            raise InputError(
                f"is {robot.speed_max_m_s:g}, which makes steps of {step_m:.3g} m, less than "
                f"{LEAST_STEP_M:g} m",
                key=f"{key}.speed_max_m_s",
                remedy="increase it, or planner.step_s",
            )
        if robot.start_spread_m > 0.0 and (problem.has_goal or not robot.moves_freely):
            raise InputError(
                f"is {robot.start_spread_m:g} m, but random starts are available only for "
                "single integrators and not for the task reach",
                key=f"{key}.start_spread_m",
                remedy="leave it out",
            )
    check_apart(problem)
    check_channel(problem)
    check_stations(problem)
    check_rule(problem)
    check_size(problem)
    for number, term in enumerate(problem.terms):
        try:
            term.check(problem.term_setting)
        except InputError as error:
            raise error.under(f"objective.terms[{number}]") from error


ONE_STATION = "keep only one entry of stations"


def check_stations(problem: Problem) -> None:
    """Raise `InputError` for station keys without their map or log, and for equal stations."""
    raster = isinstance(problem.channel.truth, RasterTruth)
    log = problem.channel.measurements
    logged = isinstance(log, LoggedMeasurements)
    named = isinstance(log, LoggedMeasurements) and log.transmitter_column is not None
    for number, radio in enumerate(problem.stations):
        for key, there, goes, table in (
            ("gain_file", radio.gain_file, raster, 'channel.truth of kind "raster"'),
            ("gain_variable", radio.gain_variable, raster, 'channel.truth of kind "raster"'),
            ("log_file", radio.log_file, logged, "channel.measurements.file"),
            ("power_column", radio.power_column, logged, "channel.measurements.file"),
            ("censored_column", radio.censored_column, logged, "channel.measurements.file"),
            ("transmitter", radio.transmitter, named, "channel.measurements.transmitter_column"),
        ):
            if there is not None and not goes:
                raise InputError(
                    f"applies only with {table}",
                    key=f"stations[{number}].{key}",
                    remedy="leave it out",
                )
    if len(problem.stations) > 1:
        _check_own_channels(problem)


def _check_own_channels(problem: Problem) -> None:
    truth, log = problem.channel.truth, problem.channel.measurements
    _no_two_alike(
        problem,
        [radio.name for radio in problem.stations],
        "name",
        "is {value!r}, the same as stations[{other}].name",
        'give each station its own name, e.g. "north"',
    )
    if isinstance(truth, RasterTruth):
        maps = [raster_truth_of(truth, radio) for radio in problem.stations]
        _no_two_alike(
            problem,
            [(own.file, own.variable) for own in maps],
            "gain_file",
            "is missing: the station would use the same map as stations[{other}]",
            "give each further station a gain_file, or a gain_variable of the same file",
        )
    if isinstance(log, LoggedMeasurements):
        logs = [log_of(log, radio) for radio in problem.stations]
        _no_two_alike(
            problem,
            [(own.file, own.log_format.columns[2], own.log_format.where) for own in logs],
            "log_file",
            "is missing or repeated: the station would have the measurements of stations[{other}]",
            "give each further station a log_file or a power_column of the same log, or give "
            "channel.measurements.transmitter_column",
        )


def _no_two_alike(
    problem: Problem, values: Sequence[object], key: str, words: str, remedy: str
) -> None:
    for number, value in enumerate(values):
        other = values.index(value)
        if other < number:
            raise InputError(
                words.format(other=other, value=value),
                key=f"stations[{number}].{key}",
                remedy=remedy,
            )


def check_rule(problem: Problem) -> None:
    """Raise an `InputError` if the planner does not support the connectivity rule."""
    rule = problem.constraints.rule
    rule.kind.check(problem)
    if problem.has_goal and rule.slack_price > 0.0:
        raise InputError(
            f"is {rule.slack_price:g}, but the task reach has no price of slack",
            key="constraints.slack_price",
            remedy="leave it out; slack_max_db limits the slack",
        )
    if rule.parameter_uncertainty == "all" and len(problem.stations) > 1:
        raise InputError(
            'is "all", which supports only one station, but the problem has '
            f"{len(problem.stations)}",
            key="constraints.parameter_uncertainty",
            remedy=f'use "path_loss", or {ONE_STATION}',
        )


REST_TOLERANCE_M = 1e-6  # Maximum change of state, in metres per step, of a robot at rest
MOST_CORNERS = 64  # Maximum number of corners of the input set at which dynamics are checked


def check_own_map(problem: Problem, number: int) -> None:
    """Raise an `InputError` if the dynamics of robot `number` are invalid."""
    robot, step_s = problem.robots[number], problem.planner.step_s
    dynamics, start = robot.dynamics, robot.start_state
    key = f"robots[{number}].dynamics"
    with calling(dynamics, "braking", key=key):
        braking = dynamics.braking(start, step_s, 1)[0]
    inputs = [braking]
    if isinstance(dynamics, RestsByInput):
        bounds = [(low, high) for low, high in dynamics.input_bounds]
        finite = [tuple(filter(math.isfinite, pair)) or (0.0,) for pair in bounds]
        inputs += [np.array(one) for one in islice(product(*finite), MOST_CORNERS)]
    for control in inputs:
        try:
            state_after(dynamics, start, control, step_s)
        except InputError as error:
            raise InputError(error.message, key=key, remedy=error.remedy) from error
    if isinstance(dynamics, RestsByInput):
        change = np.abs(dynamics.change_at_rest(start, step_s) * dynamics.unit_m(step_s))
        if not float(change.max()) <= REST_TOLERANCE_M:
            raise InputError(
                f"is {list(dynamics.rest_input)}, but with this input the robot still moves by "
                f"{float(change.max()):.3g} m per step",
                key=f"{key}.rest_input",
                remedy="give the input at which the robot stays at rest; if the function returns a "
                "derivative, set continuous = True",
            )


def check_stopping(problem: Problem, index: ObstacleIndex, number: int) -> None:
    """Raise an `InputError` if robot `number` cannot brake in time from its start."""
    robot = problem.robots[number]
    curve = robot.dynamics.stop_curve(robot.start_state, problem.planner.step_s)
    if curve is None:
        return
    places, within = curve.points_m()
    bounds = np.array(problem.workspace.bounds_m)
    outside = (places - within < bounds[:2]).any() or (places + within > bounds[2:]).any()
    if outside or curve.clearance_m(index) < problem.constraints.clearance_m:
        raise InputError(
            f"is {list(robot.start_rest)}, at which the robot cannot stop "
            + ("within world.bounds_m" if outside else "before the obstacles ahead"),
            key=f"robots[{number}].start_velocity_m_s",
            remedy="reduce it, or start elsewhere",
        )
