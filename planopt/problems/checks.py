"""Check a problem beyond the ranges of single keys; each error carries the key to change.

These checks need geometry, or two tables at once: robots start apart from each other and from
moving obstacles and can stop so; the tables of a channel fit each other; starts and goals are
clear of obstacles; the ground truth and the lattice fit into memory; each of several stations has a
channel of its own, and the rule of connectivity can be computed for them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import islice, product
from typing import TYPE_CHECKING

import numpy as np
import shapely

from planopt.errors import InputError
from planopt.keys import LARGEST_COORDINATE_M
from planopt.objectives.terms.term import Term
from planopt.parts import calling
from planopt.problems.channel_setup import (
    ArrayTruth,
    FittedTruth,
    FunctionTruth,
    LoggedMeasurements,
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
from planopt.world.motion import CLOSE_M, step_distances_m
from planopt.world.moving_discs import centres_at
from planopt.world.workspace import node_estimate

if TYPE_CHECKING:
    from planopt.problems.problem import Problem

CLEARANCE_TO_GOALS_M = 0.01
"""Goals are this much farther from each other than the separation: planners keep a little more."""


def check_apart(problem: Problem) -> None:
    """Check that robots start apart from each other and from moving obstacles."""
    separation = problem.constraints.separation_m
    starts = np.array([robot.start_m for robot in problem.robots])
    for number, robot in enumerate(problem.robots):
        for other in range(number):
            distance = float(np.linalg.norm(starts[number] - starts[other]))
            drawn = robot.start_spread_m + problem.robots[other].start_spread_m > 0.0
            if distance < separation and not drawn:
                raise InputError(
                    f"is {list(robot.start_m)}, {distance:.3g} m from the start of "
                    f"{problem.robots[other].name}, less than the separation of {separation:g} m",
                    key=f"robots[{number}].start_m",
                    remedy="move it, or lessen constraints.separation_m",
                )
            _check_goals_apart(problem, number, other)
            _check_stopping_apart(problem, number, other)
        for obstacle in problem.workspace.moving:
            centre = centres_at(obstacle, np.zeros(1))[0]
            distance = float(np.linalg.norm(starts[number] - centre)) - obstacle.radius_m
            if distance < problem.constraints.clearance_m:
                raise InputError(
                    f"is {list(robot.start_m)}, {distance:.3g} m from where the moving obstacle "
                    f"{obstacle.name} is at time 0, less than the clearance of "
                    f"{problem.constraints.clearance_m:g} m",
                    key=f"robots[{number}].start_m",
                    remedy="move it, or lessen constraints.clearance_m",
                )


def _check_goals_apart(problem: Problem, number: int, other: int) -> None:
    """Check that two robots can stand at their goals at the same time."""
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
            f"is {list(goal)}, {distance:.3g} m from the goal of {problem.robots[other].name}, "
            f"not more than the separation of {separation:g} m",
            key=f"robots[{number}].goal_m",
            remedy="move it, or lessen constraints.separation_m",
        )


def _check_stopping_apart(problem: Problem, number: int, other: int) -> None:
    """Check that two robots keep apart if both stop, so that there is always a safe plan."""
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
            f"is {list(problem.robots[fast].start_rest)}: stopping from there leads within "
            f"{distance:.3g} m of {problem.robots[slow].name}, less than the separation of "
            f"{separation:g} m",
            key=f"robots[{fast}].start_velocity_m_s",
            remedy="lessen it, start elsewhere, or lessen constraints.separation_m",
        )


MAX_TRUTH_CELLS = 4_000_000
"""A drawn truth of more cells than this would not fit the memory of a small machine."""


def check_channel(problem: Problem) -> None:
    """Check that measurements have a source and that the floor is below the thresholds."""
    truth = problem.channel.truth
    measurements = problem.channel.measurements
    if truth is None:
        if isinstance(measurements, SampledMeasurements) and measurements.count > 0:
            raise InputError(
                "measurements cannot be taken from a truth that is not given",
                key="channel.measurements.count",
                remedy="add [channel.truth], or give the file of a log",
            )
        return
    if isinstance(truth, ModelTruth | FittedTruth | FunctionTruth):
        _check_cells(problem, truth.cell_m)
    sampled = isinstance(measurements, SampledMeasurements) and measurements.count > 0
    if isinstance(truth, FittedTruth) and sampled:
        raise InputError(
            'is "fitted", and there is no log to fit',
            key="channel.truth.kind",
            remedy="give the log as channel.measurements.file",
        )
    for index, station in enumerate(problem.stations):
        if isinstance(truth, ArrayTruth | FunctionTruth):
            floor_dbm, remedy = truth.floor_dbm, "lower channel.truth.floor_dbm"
        else:
            floor_db = truth.floor_db
            floor_dbm = None if floor_db is None else station.transmit_power_dbm + floor_db
            remedy = "the floor is transmit_power_dbm + channel.truth.floor_db"
        for key in ("threshold_dbm", "receive_threshold_dbm"):
            least_dbm = getattr(station, key)
            if floor_dbm is not None and least_dbm is not None and floor_dbm >= least_dbm:
                raise InputError(
                    f"is {least_dbm:g}, not above the receiver's floor of {floor_dbm:g} "
                    "dBm, so that places without signal would count as connected",
                    key=f"stations[{index}].{key}",
                    remedy=remedy,
                )


def _check_cells(problem: Problem, cell_m: float) -> None:
    """Refuse cells so small that the truth would not fit into memory."""
    if not 0.0 < cell_m <= LARGEST_COORDINATE_M:
        raise InputError(
            f"is {cell_m!r}, which is no cell side",
            key="channel.truth.cell_m",
            remedy="give metres above 0",
        )
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    cells = (x_max - x_min) / cell_m * (y_max - y_min) / cell_m
    if cells > MAX_TRUTH_CELLS:
        raise InputError(
            f"is {cell_m:g}, which makes {cells:.3g} cells, more than {MAX_TRUTH_CELLS:.3g}",
            key="channel.truth.cell_m",
            remedy="larger cells, or smaller bounds",
        )


def _check_spread(problem: Problem, number: int) -> None:
    """Check that starts are drawn only for sums of terms and single integrators."""
    robot = problem.robots[number]
    if robot.start_spread_m > 0.0 and (problem.task == "reach" or not robot.moves_freely):
        raise InputError(
            f"is {robot.start_spread_m:g}, and starts are drawn only of single integrators, and "
            "not for the task reach",
            key=f"robots[{number}].start_spread_m",
            remedy="leave it out",
        )


def check_bounds(problem: Problem) -> None:
    """Check that the bounds have an inside."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    if not (x_min < x_max and y_min < y_max):
        raise InputError(
            f"is {list(problem.workspace.bounds_m)}, should have x_min < x_max and y_min < y_max",
            key="world.bounds_m",
            remedy="[x_min, y_min, x_max, y_max]",
        )


def check_place(
    problem: Problem, index: ObstacleIndex, place: tuple[float, float], key: str
) -> None:
    """Check that a position of a robot is within the bounds and clear of every obstacle."""
    positions_m = np.array([place])
    if not inside_bounds(problem.workspace, positions_m).all():
        raise InputError(
            f"is {list(place)}, outside the bounds {list(problem.workspace.bounds_m)}",
            key=key,
            remedy="move it, or widen world.bounds_m",
        )
    around = containing_obstacle(index, positions_m[0])
    if around is not None:
        raise InputError(
            f"is {list(place)}, inside the obstacle {around.name}",
            key=key,
            remedy="move it",
        )
    distance = float(clearance_m(index, positions_m)[0])
    if distance < problem.constraints.clearance_m:
        nearest = index.obstacles[int(index.tree.nearest(shapely.Point(place)))]
        raise InputError(
            f"is {list(place)}, {distance:.3g} m from the obstacle {nearest.name}, less than "
            f"the clearance of {problem.constraints.clearance_m:g} m",
            key=key,
            remedy="move it, or lessen constraints.clearance_m",
        )


NODE_BYTES, STAGE_BYTES = 1700, 8
"""Memory of a node of the lattice, and of a node at one stage of the horizon, as measured."""

LARGEST_LATTICE_BYTES = 4 * 10**9
"""Limit of the memory that the lattices of all robots take together."""


def check_size(problem: Problem) -> None:
    """Refuse a step so short for the bounds that the search would take many gigabytes."""
    horizon = problem.planner.horizon
    nodes = sum(
        node_estimate(problem.workspace, robot.speed_max_m_s * problem.planner.step_s)
        for robot in problem.robots
    )
    needed = nodes * (NODE_BYTES + STAGE_BYTES * horizon)
    if needed > LARGEST_LATTICE_BYTES:
        raise InputError(
            f"is {problem.planner.step_s:g}, which for these bounds and speeds makes a lattice of "
            f"{nodes:.2g} nodes; with a horizon of {horizon} it would take "
            f"{needed / 1e9:.2g} GB, more than {LARGEST_LATTICE_BYTES / 1e9:g} GB",
            key="planner.step_s",
            remedy="lengthen the step, or narrow world.bounds_m, or lower planner.horizon",
        )


LEAST_STEP_M = 1e-3
"""Shorter steps are lost in the tolerances of planning."""


def check(problem: Problem) -> None:
    """Raise the first fault of `problem`."""
    check_bounds(problem)
    index = index_obstacles(problem.workspace)
    for number, robot in enumerate(problem.robots):
        check_place(problem, index, robot.start_m, f"robots[{number}].start_m")
        if robot.goal_m is not None:
            check_place(problem, index, robot.goal_m, f"robots[{number}].goal_m")
        check_own_map(problem, number)
        check_stopping(problem, index, number)
        _check_step(problem, number)
        _check_spread(problem, number)
    check_apart(problem)
    check_channel(problem)
    check_stations(problem)
    check_rule(problem)
    check_size(problem)
    for number, term in enumerate(problem.terms):
        _check_term(problem, term, f"objective.terms[{number}]")


def _check_term(problem: Problem, term: Term, key: str) -> None:
    """Check that a term can be planned for in its problem."""
    try:
        term.check(problem.term_setting)
    except InputError as error:
        raise InputError(
            error.message,
            file=error.file,
            row=error.row,
            key=f"{key}.{error.key}" if error.key else key,
            remedy=error.remedy,
        ) from error


def _check_step(problem: Problem, number: int) -> None:
    """Check that the longest step of a robot is not too short."""
    speed_m_s = problem.robots[number].speed_max_m_s
    step_m = speed_m_s * problem.planner.step_s
    if step_m < LEAST_STEP_M:
        raise InputError(
            f"is {speed_m_s:g}, which makes steps of {step_m:.3g} m, less than {LEAST_STEP_M:g} m",
            key=f"robots[{number}].speed_max_m_s",
            remedy="raise it, or planner.step_s",
        )


ONE_STATION = "leave one entry of stations"


def check_stations(problem: Problem) -> None:
    """Raise what keeps a problem's stations from being planned with."""
    _check_keys(problem)
    if len(problem.stations) > 1:
        _check_own_channels(problem)


def _check_keys(problem: Problem) -> None:
    """Refuse keys of a station that go only with a map or a log."""
    raster = isinstance(problem.channel.truth, RasterTruth)
    logged = isinstance(problem.channel.measurements, LoggedMeasurements)
    for number, radio in enumerate(problem.stations):
        for key, there, goes, table in (
            ("gain_file", radio.gain_file, raster, 'channel.truth of kind "raster"'),
            ("gain_variable", radio.gain_variable, raster, 'channel.truth of kind "raster"'),
            ("log_file", radio.log_file, logged, "channel.measurements.file"),
            ("power_column", radio.power_column, logged, "channel.measurements.file"),
            ("censored_column", radio.censored_column, logged, "channel.measurements.file"),
        ):
            if there is not None and not goes:
                raise InputError(
                    f"goes only with {table}",
                    key=f"stations[{number}].{key}",
                    remedy="leave it out",
                )


def _check_own_channels(problem: Problem) -> None:
    truth, log = problem.channel.truth, problem.channel.measurements
    _no_two_alike(
        problem,
        [radio.name for radio in problem.stations],
        "name",
        "is {value!r}, as that of stations[{other}] is",
        "give each station a name of its own, e.g. BaseStation(name='north', ...)",
    )
    if isinstance(truth, RasterTruth):
        maps = [raster_truth_of(truth, radio) for radio in problem.stations]
        _no_two_alike(
            problem,
            [(own.file, own.variable) for own in maps],
            "gain_file",
            "is needed: the map of path gains would be that of stations[{other}]",
            "give each further station a gain_file, or a gain_variable of the same file",
        )
    if isinstance(log, LoggedMeasurements):
        logs = [log_of(log, radio) for radio in problem.stations]
        _no_two_alike(
            problem,
            [(own.file, own.columns[2]) for own in logs],
            "log_file",
            "is needed: the measured powers would be those of stations[{other}]",
            "give each further station a log_file, or a power_column of the same log",
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
    """Raise what keeps a problem's rule of connectivity from being planned with."""
    rule = problem.constraints.rule
    rule.kind.check(problem)
    if problem.task == "reach" and rule.slack_price > 0.0:
        raise InputError(
            f"is {rule.slack_price:g}, but the objective of task reach has no price for slack",
            key="constraints.slack_price",
            remedy="leave it out: slack_max_db alone bounds the slack",
        )
    if rule.parameter_uncertainty == "all" and len(problem.stations) > 1:
        raise InputError(
            f"all is for one station, and there are {len(problem.stations)}",
            key="constraints.parameter_uncertainty",
            remedy=f"ask for path_loss, or {ONE_STATION}",
        )


REST_TOLERANCE_M = 1e-6
"""A robot that rests changes its state by no more than this in a step."""

MOST_CORNERS = 64
"""Number of corners of the input set that are checked at the start."""


def check_own_map(problem: Problem, number: int) -> None:
    """Raise an error if the dynamics of robot number `number` cannot be driven."""
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
                f"{list(dynamics.rest_input)} does not let it rest: its state goes on changing, by "
                f"{float(change.max()):.3g} m a step, as far as a search finds",
                key=f"{key}.rest_input",
                remedy="give the input with which it stays where it is; a function that is a "
                "derivative needs continuous = True",
            )


def check_stopping(problem: Problem, index: ObstacleIndex, number: int) -> None:
    """Raise an error if robot number `number` cannot brake in time from its start."""
    robot = problem.robots[number]
    curve = robot.dynamics.stop_curve(robot.start_state, problem.planner.step_s)
    if curve is None:
        return
    places, within = curve.points_m()
    bounds = np.array(problem.workspace.bounds_m)
    outside = (places - within < bounds[:2]).any() or (places + within > bounds[2:]).any()
    if outside or curve.clearance_m(index) < problem.constraints.clearance_m:
        raise InputError(
            f"is {list(robot.start_rest)}, too fast to stop "
            + ("within world.bounds_m" if outside else "clear of the obstacles ahead"),
            key=f"robots[{number}].start_velocity_m_s",
            remedy="lessen it, or start elsewhere",
        )
