"""Draw the initial data of a run: ground truth, first measurements, and drawn starts.

All follow from the problem and the seed, each from a random stream of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.fit import fit_channel
from planopt.channel.fields.truth import (
    Truth,
    fitted_truth,
    measure,
    model_truth,
    power_truth,
    raster_truth,
)
from planopt.channel.measurements import (
    LARGEST_POWER_DBM,
    LEAST_POWER_DBM,
    Measurements,
    Table,
    as_received,
)
from planopt.channel.parameters import ChannelParameters
from planopt.channel.posterior import EXACT_LIMIT, condition
from planopt.channel.power_log import LogFormat, read_log
from planopt.errors import InputError
from planopt.parts import calling
from planopt.problems.base_station import log_of, raster_truth_of
from planopt.problems.channel_setup import (
    ArrayTruth,
    FittedTruth,
    FunctionTruth,
    LoggedMeasurements,
    ModelTruth,
    RasterTruth,
    SampledMeasurements,
)
from planopt.problems.problem import Problem
from planopt.problems.robot import Robot
from planopt.problems.target import Target
from planopt.world.clearance import ObstacleIndex, clearance_m, index_obstacles, inside_bounds
from planopt.world.raster import Raster, cell_centres_m
from planopt.world.raster_files import read_raster


@dataclass(frozen=True, eq=False)
class TeamSeeds:
    """Streams apart from those of truth and measurements, so that other tasks leave these alone."""

    target: np.random.Generator  # Of the target's way, its first estimate and the sensors' noise
    planners: tuple[np.random.Generator, ...]  # One a robot, for planners that draw


def team_seeds(problem: Problem, seed: int) -> TeamSeeds:
    """The streams of `seed`, unused."""
    target, planners = np.random.SeedSequence(seed, spawn_key=(1,)).spawn(2)
    return TeamSeeds(
        np.random.default_rng(target),
        tuple(np.random.default_rng(stream) for stream in planners.spawn(len(problem.robots))),
    )


GivenMeasurements = Measurements | Table | Sequence[Measurements | Table]
"""First measurements that a user gives: a table, or one for each station."""

LARGEST_GAIN_DB = 500.0
"""Path gains of maps are within this of 0 dB, as those of problem files."""

FURTHER_STREAMS = 2
"""The first station's fading, the measured places and what a team draws have other streams."""


@dataclass(frozen=True, eq=False)
class Given:
    """Ground truth and first measurements of one seed."""

    truth: Truth | None  # The channel as it is; None if the problem has none
    measurements: Measurements  # The first measurements
    # The same of each further station, in the problem's order; they have none
    further: tuple[Given, ...] = ()

    @property
    def stations(self) -> tuple[Given, ...]:
        """Return what there is of each station, the first one's first."""
        return (self, *self.further)

    @property
    def truths(self) -> tuple[Truth, ...]:
        """Return the ground truth of each station; empty if the problem has none."""
        return tuple(given.truth for given in self.stations if given.truth is not None)


def draw(problem: Problem, seed: int, measurements: Sequence[Measurements] | None = None) -> Given:
    """Draw the truth, and take or read the first measurements."""
    if not isinstance(cast("object", seed), int | np.integer) or seed < 0:
        raise InputError(
            f"is {seed!r}, should be a whole number, at least 0",
            key="seed",
            remedy="give 0, 1, ...",
        )
    fading_seed, places_seed = np.random.SeedSequence(seed).spawn(2)
    fading_seeds = [fading_seed] + [
        np.random.SeedSequence(seed, spawn_key=(FURTHER_STREAMS, number))
        for number in range(1, len(problem.stations))
    ]
    generators = [np.random.default_rng(stream) for stream in fading_seeds]
    truths = [
        draw_truth(problem, generator, station) for station, generator in enumerate(generators)
    ]
    setup = problem.channel.measurements
    if measurements is not None:
        measured = list(measurements)
    elif isinstance(setup, LoggedMeasurements):
        measured = [_read_log(log_of(setup, radio)) for radio in problem.stations]
    else:
        known = problem.channel.given
        if setup.count == 0 and (known is None or known.k_pl_db is None):
            raise InputError(
                "there are no first measurements",
                file=problem.file,
                key="channel.measurements",
                remedy="give measurements= to solve, simulate or Planner, or a count or a log to "
                "the problem's channel",
            )
        places = free_places(problem, setup.count, np.random.default_rng(places_seed))
        measured = [_measured(problem, truth, places) for truth in truths]
    if isinstance(problem.channel.truth, FittedTruth):
        truths = [
            _fitted_truth(problem, problem.channel.truth, station, *each)
            for station, each in enumerate(zip(measured, generators, strict=True))
        ]
    stations = [Given(*both) for both in zip(truths, measured, strict=True)]
    return replace(stations[0], further=tuple(stations[1:]))


def _read_log(log: LoggedMeasurements) -> Measurements:
    return read_log(log.file, LogFormat(log.columns, log.censored_column, log.floor_dbm))


def _measured(problem: Problem, truth: Truth | None, places_m: NDArray[np.float64]) -> Measurements:
    if truth is None:
        raise InputError(
            "there is no truth to measure",
            file=problem.file,
            key="channel.truth",
            remedy="give channel.truth, or a log as channel.measurements.file",
        )
    return measure(truth, places_m)


def _fitted_truth(
    problem: Problem,
    setup: FittedTruth,
    station: int,
    log: Measurements,
    generator: np.random.Generator,
) -> Truth:
    """Fit a station's log and draw the truth from the posterior."""
    radio = problem.stations[station]
    fit = fit_channel(log, radio.site, problem.channel.fit_method)
    if len(log) > EXACT_LIMIT:
        log = log.take(np.sort(generator.choice(len(log), EXACT_LIMIT, replace=False)))
    floor = None if setup.floor_db is None else setup.floor_db + radio.transmit_power_dbm
    posterior = condition(fit.parameters, log)
    return fitted_truth(posterior, problem.workspace.bounds_m, setup.cell_m, floor, generator)


def draw_truth(problem: Problem, generator: np.random.Generator, station: int = 0) -> Truth | None:
    """Draw the truth of one station; None if the problem has none, or one drawn from a log."""
    setup, radio = problem.channel.truth, problem.stations[station]
    if isinstance(setup, RasterTruth):
        setup = raster_truth_of(setup, radio)
        gain = read_raster(setup.file, setup.variable)
        _require_quantity(setup, gain)
        if setup.quantity == "power":
            gain = replace(gain, values=gain.values - radio.transmit_power_dbm)
        # A comparison with NaN is false: no value is no fault.
        if (np.abs(gain.values) > LARGEST_GAIN_DB).any():
            raise InputError(
                f"has values from {np.nanmin(gain.values):g} to {np.nanmax(gain.values):g}, which "
                "are no path gains in dB",
                file=setup.file,
                key=setup.variable,
                remedy=f"give decibels within {LARGEST_GAIN_DB:g}",
            )
        return raster_truth(
            gain, radio.transmit_power_dbm, setup.floor_db, setup.multipath, generator
        )
    if isinstance(setup, ModelTruth):
        parameters = ChannelParameters(
            k_pl_db=setup.k_pl_db + radio.transmit_power_dbm,
            n_pl=setup.n_pl,
            shadow_std_db=setup.shadow_std_db,
            decorrelation_m=setup.decorrelation_m,
            multipath_std_db=setup.multipath_std_db,
            station=radio.site,
        )
        floor = None if setup.floor_db is None else setup.floor_db + radio.transmit_power_dbm
        return model_truth(
            parameters,
            problem.workspace.bounds_m,
            setup.cell_m,
            floor,
            generator,
            setup.multipath,
        )
    if isinstance(setup, ArrayTruth | FunctionTruth):
        return _given_truth(problem, setup, station)
    return None


def _require_quantity(setup: RasterTruth, raster: Raster) -> None:
    """Refuse a map whose file says that it has another quantity."""
    other = {"gain": "dBm", "power": "dB"}[setup.quantity]
    spread = raster.quantity.startswith("standard deviation")
    if raster.unit not in (other, "1") and not spread:
        return
    remedy = "name a variable that has path gain in dB or received power in dBm"
    if raster.unit == other and not spread:
        remedy = f'set channel.truth.quantity = "{"power" if other == "dBm" else "gain"}"'
    raise InputError(
        f"has {raster.quantity or 'values'} in {raster.unit}, and channel.truth.quantity is "
        f"{setup.quantity!r}",
        file=setup.file,
        key=setup.variable,
        remedy=remedy,
    )


def _given_truth(problem: Problem, setup: ArrayTruth | FunctionTruth, station: int) -> Truth:
    """Return the truth of a station from arrays or from a function of places."""
    if isinstance(setup, ArrayTruth):
        x, y, values = (
            _numbers(key, array)
            for key, array in (
                ("x_m", setup.x_m),
                ("y_m", setup.y_m),
                ("power_dbm", setup.power_dbm),
            )
        )
        several = values.ndim == 3
    else:
        x_min, y_min, x_max, y_max = problem.workspace.bounds_m
        x = cell_centres_m(x_min, x_max, setup.cell_m)
        y = cell_centres_m(y_min, y_max, setup.cell_m)
        places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        with calling(setup.power_dbm, "", key="channel.truth.power_dbm"):
            powers = setup.power_dbm(places)
        values = _numbers("power_dbm", powers)
        several = values.ndim == 2
        if values.shape[-1:] != (len(places),):
            raise InputError(
                f"returned shape {values.shape} for {len(places)} places",
                key="channel.truth.power_dbm",
                remedy="return a power for each place, (n,) or (stations, n)",
            )
        values = values.reshape(*values.shape[:-1], len(y), len(x))
    if several != (len(problem.stations) > 1) or (several and len(values) != len(problem.stations)):
        raise InputError(
            f"has powers of shape {values.shape} for {len(problem.stations)} stations",
            key="channel.truth.power_dbm",
            remedy="give the powers of all stations, (stations, ny, nx) as an array or "
            "(stations, n) by a function",
        )
    truth = power_truth(x, y, values[station] if several else values, setup.floor_dbm)
    least, largest = float(truth.raster.values.min()), float(truth.raster.values.max())
    if least < LEAST_POWER_DBM or largest > LARGEST_POWER_DBM:
        raise InputError(
            f"has powers from {least:g} to {largest:g}, which no receiver measures in dBm",
            key="channel.truth.power_dbm",
            remedy=f"give dBm from {LEAST_POWER_DBM:g} to {LARGEST_POWER_DBM:g}, or NaN and a "
            "floor_dbm where nothing arrives",
        )
    return truth


def _numbers(key: str, values: object) -> NDArray[np.float64]:
    """Return an array of numbers, or say under which key there is none."""
    try:
        found = np.asarray(values)
        # NumPy would read numbers from text, and leave out imaginary parts.
        if found.dtype.kind in "iufO":
            return found.astype(np.float64)
        kind = "text" if found.dtype.kind in "US" else f"numbers of type {found.dtype}"
    except (TypeError, ValueError):
        kind = type(values).__name__
    raise InputError(
        f"is {kind}, no array of real numbers",
        key=f"channel.truth.{key}",
        remedy="give real numbers, e.g. numpy.full(len(places_m), -60.0)",
    )


def with_measurements(
    problem: Problem, measurements: GivenMeasurements | None
) -> tuple[Problem, tuple[Measurements, ...] | None]:
    """Return a problem without first measurements of its own, and those that a user gave.

    Without any, the problem as it is and None. Parameters and errors are those of
    :func:`measurements_by_station`.
    """
    if measurements is None:
        return problem, None
    given = measurements_by_station(problem, measurements)
    bare = tuple(
        replace(station, log_file=None, power_column=None, censored_column=None)
        for station in problem.stations
    )
    channel = replace(problem.channel, measurements=SampledMeasurements())
    return replace(problem, stations=bare, channel=channel), given


def measurements_by_station(
    problem: Problem, measurements: GivenMeasurements
) -> tuple[Measurements, ...]:
    """Return measurements that a user gave, one table for each station."""
    if isinstance(measurements, str | bytes | Path):
        raise InputError(
            f"is {measurements!r}, no table of measurements",
            key="measurements",
            remedy="read a file with planopt.channel.read_log, or name it in "
            "channel.measurements.file",
        )
    if isinstance(measurements, Sequence):
        tables = list(measurements)
    else:
        tables = [measurements]
    if len(tables) != len(problem.stations):
        raise InputError(
            f"measurements of {len(tables)} stations were given, the problem has "
            f"{len(problem.stations)}",
            key="measurements",
            remedy="give a sequence with one table for each station, in the problem's order",
        )
    return tuple(as_received(table) for table in tables)


DRAWN_STREAM = 3
"""Stream of starts that are drawn; the others' are named above."""

MOST_DRAWS = 10_000
"""A start that has not been found after so many draws is refused."""


def with_drawn_starts(problem: Problem, seed: int) -> Problem:
    """Return the problem with the starts that it draws: of robots near a place, and of a target."""
    spread = any(robot.start_spread_m > 0.0 for robot in problem.robots)
    moved = any(target.start_distance_m is not None for target in problem.targets)
    if not spread and not moved:
        return problem
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(DRAWN_STREAM,)))
    index = index_obstacles(problem.workspace)
    robots: list[Robot] = []
    for number in range(len(problem.robots)):
        robots.append(_drawn_robot(problem, index, number, robots, generator))
    targets = tuple(_drawn_target(problem, index, each, generator) for each in problem.targets)
    return replace(problem, robots=tuple(robots), targets=targets)


def _drawn_robot(
    problem: Problem,
    index: ObstacleIndex,
    number: int,
    before: Sequence[Robot],
    generator: np.random.Generator,
) -> Robot:
    robot, constraints = problem.robots[number], problem.constraints
    if robot.start_spread_m == 0.0:
        return robot
    fixed = [each for each in problem.robots[number + 1 :] if each.start_spread_m == 0.0]
    others = np.array([each.start_m for each in (*before, *fixed)]).reshape(-1, 2)
    for _ in range(MOST_DRAWS):
        angle, share = generator.uniform(0.0, 2.0 * np.pi), np.sqrt(generator.uniform())
        away = robot.start_spread_m * share * np.array([np.cos(angle), np.sin(angle)])
        place = np.asarray(robot.start_m) + away
        apart = np.linalg.norm(others - place, axis=1)
        if _is_free(problem, index, place[None], constraints.clearance_m) and (
            not len(apart) or apart.min() >= constraints.separation_m
        ):
            return replace(robot, start_m=(float(place[0]), float(place[1])), start_spread_m=0.0)
    raise InputError(
        f"leaves no free place within {robot.start_spread_m:g} m of {list(robot.start_m)}",
        file=problem.file,
        key=f"robots[{number}].start_spread_m",
        remedy="widen it, or lessen constraints.separation_m",
    )


def _drawn_target(
    problem: Problem, index: ObstacleIndex, target: Target, generator: np.random.Generator
) -> Target:
    if target.start_distance_m is None:
        return target
    speed = float(np.hypot(*target.velocity_m_s))
    ahead_s = problem.planner.step_s * np.arange(problem.planner.max_steps + 1)
    for _ in range(MOST_DRAWS):
        angle = generator.uniform(0.0, 2.0 * np.pi)
        heading = angle + target.heading_spread_rad * generator.uniform(-1.0, 1.0)
        away = target.start_distance_m * np.array([np.cos(angle), np.sin(angle)])
        place = np.asarray(target.start_m) + away
        velocity = speed * np.array([np.cos(heading), np.sin(heading)])
        path = place + ahead_s[:, None] * velocity
        if not target.stays_free or _is_free(problem, index, path, 0.0):
            return replace(
                target,
                start_m=(float(place[0]), float(place[1])),
                velocity_m_s=(float(velocity[0]), float(velocity[1])),
                start_distance_m=None,
                heading_spread_rad=0.0,
            )
    raise InputError(
        "finds no straight path that stays within the bounds and out of obstacles for "
        f"{problem.planner.max_steps} steps",
        file=problem.file,
        key="targets[0].stays_free",
        remedy="lessen the target's speed or planner.max_steps, or widen world.bounds_m",
    )


def _is_free(
    problem: Problem, index: ObstacleIndex, places_m: NDArray[np.float64], clearance: float
) -> bool:
    """Return whether all places (n, 2) are within the bounds and so far from obstacles."""
    if not inside_bounds(problem.workspace, places_m).all():
        return False
    away = clearance_m(index, places_m)
    return bool((away >= clearance).all() and (away > 0.0).all())


def free_target_path(
    problem: Problem, draw_path: Callable[[], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Draw a target's states (n + 1, 4) until they stay free, where the target is to."""
    if not problem.targets[0].stays_free:
        return draw_path()
    index = index_obstacles(problem.workspace)
    for _ in range(MOST_DRAWS):
        states = draw_path()
        if _is_free(problem, index, states[:, :2], 0.0):
            return states
    raise InputError(
        f"finds none in {MOST_DRAWS:,} paths that stays within the bounds and out of obstacles",
        file=problem.file,
        key="targets[0].stays_free",
        remedy="let it start elsewhere or slower, or leave the key out",
    )


def free_places(
    problem: Problem, count: int, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Draw `count` places uniformly from the workspace outside obstacles; (count, 2)."""
    index = index_obstacles(problem.workspace)
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    kept: list[NDArray[np.float64]] = []
    found = 0
    for _ in range(1000):
        drawn = generator.uniform((x_min, y_min), (x_max, y_max), (max(2 * count, 64), 2))
        free = drawn[clearance_m(index, drawn) > 0.0]
        kept.append(free)
        found += len(free)
        if found >= count:
            return np.concatenate(kept)[:count]
    raise InputError(
        "the obstacles leave no place to measure at",
        file=problem.file,
        key="world.obstacles",
        remedy="remove some, or widen world.bounds_m",
    )
