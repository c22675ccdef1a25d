"""Initial data of a run, drawn from a seed, and beliefs fitted to initial measurements.

Ground truth, initial measurements and targets use separate random streams.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from planopt.arrays import Floats, require_seed
from planopt.channel.cholesky import one_blas_thread
from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.fit import fit_channel
from planopt.channel.ground_truth import (
    Truth,
    fitted_truth,
    measure,
    measured_truth,
    model_truth,
    power_truth,
    raster_truth,
)
from planopt.channel.logs.power_log import read_log
from planopt.channel.measurements import (
    LARGEST_POWER_DBM,
    LEAST_POWER_DBM,
    Measurements,
    Table,
    as_received,
)
from planopt.channel.parameters import PRIOR_N_PL, ChannelParameters
from planopt.channel.posterior import EXACT_LIMIT, Belief, ChannelPosterior, condition
from planopt.errors import InputError
from planopt.parts import calling
from planopt.planning.free_space import free_places
from planopt.problems.channel_setup import (
    ArrayTruth,
    FittedTruth,
    FunctionTruth,
    GivenParameters,
    LoggedMeasurements,
    MeasuredTruth,
    ModelTruth,
    RasterTruth,
    SampledMeasurements,
    log_of,
    raster_truth_of,
)
from planopt.problems.problem import Problem
from planopt.world.raster import Raster, cell_centres_m
from planopt.world.raster_files import read_raster


@dataclass(frozen=True, eq=False)
class TeamSeeds:
    """Independent random streams of a team of robots."""

    target: np.random.Generator  # Target path, its initial estimate and sensor noise
    planners: tuple[np.random.Generator, ...]  # One per robot's planner


def team_seeds(problem: Problem, seed: int) -> TeamSeeds:
    """Return the random streams of a team for a random seed."""
    target, planners = np.random.SeedSequence(seed, spawn_key=(1,)).spawn(2)
    return TeamSeeds(
        np.random.default_rng(target),
        tuple(np.random.default_rng(stream) for stream in planners.spawn(len(problem.robots))),
    )


UserMeasurements = Measurements | Table | Sequence[Measurements | Table]
"""User-supplied measurements: one table for a single station, or one per station."""
LARGEST_GAIN_DB = 500.0  # Maximum magnitude of path gains in maps and problem files, in dB
FURTHER_STREAMS = 2  # Number of the random stream for the fading of further stations


@dataclass(frozen=True, eq=False)
class InitialData:
    """Ground truth and initial measurements of each station for one seed."""

    truths: tuple[Truth, ...]  # Empty if the problem has none
    measurements: tuple[Measurements, ...]


def draw_initial_data(
    problem: Problem, seed: int, measurements: Sequence[Measurements] | None = None
) -> InitialData:
    """Return a drawn ground truth and the initial `measurements`, drawn as well if None."""
    require_seed(seed)
    fading, places = np.random.SeedSequence(seed).spawn(2)
    further = [
        np.random.SeedSequence(seed, spawn_key=(FURTHER_STREAMS, number))
        for number in range(1, len(problem.stations))
    ]
    generators = [np.random.default_rng(stream) for stream in (fading, *further)]
    drawn = [
        draw_truth(problem, generator, station) for station, generator in enumerate(generators)
    ]
    truths = tuple(truth for truth in drawn if truth is not None)
    if measurements is None:
        measurements = _first_measurements(problem, truths, np.random.default_rng(places))
    setup = problem.channel.truth
    if isinstance(setup, FittedTruth):
        truths = tuple(
            _fitted_truth(problem, setup, station, *each)
            for station, each in enumerate(zip(measurements, generators, strict=True))
        )
    return InitialData(truths, tuple(measurements))


def _first_measurements(
    problem: Problem, truths: Sequence[Truth], generator: np.random.Generator
) -> list[Measurements]:
    """Return the initial measurements of each station, from logs or drawn at random positions."""
    setup, known = problem.channel.measurements, problem.channel.given
    if isinstance(setup, LoggedMeasurements):
        logs = [log_of(setup, radio) for radio in problem.stations]
        return [read_log(log.file, log.log_format) for log in logs]
    if setup.count == 0 and (known is None or known.k_pl_db is None):
        raise InputError(
            "is missing: there are no initial measurements",
            file=problem.file,
            key="channel.measurements",
            remedy="set channel.measurements.count or .file, or call solve, simulate or Planner "
            "with measurements=...",
        )
    if not truths:
        raise InputError(
            "is missing: without a ground truth there is nothing to measure",
            file=problem.file,
            key="channel.truth",
            remedy="add [channel.truth], or name a log in channel.measurements.file",
        )
    places = free_places(problem, setup.count, generator)
    return [measure(truth, places) for truth in truths]


def _fitted_truth(
    problem: Problem,
    setup: FittedTruth,
    station: int,
    log: Measurements,
    generator: np.random.Generator,
) -> Truth:
    """Return a station's ground truth, drawn from the channel posterior of its log."""
    radio = problem.stations[station]
    fit = fit_channel(log, radio.site, problem.channel.fit_method)
    if len(log) > EXACT_LIMIT:
        log = log.take(np.sort(generator.choice(len(log), EXACT_LIMIT, replace=False)))
    floor = None if setup.floor_db is None else setup.floor_db + radio.transmit_power_dbm
    posterior = condition(fit.parameters, log)
    return fitted_truth(posterior, problem.workspace.bounds_m, setup.cell_m, floor, generator)


def draw_truth(problem: Problem, generator: np.random.Generator, station: int = 0) -> Truth | None:
    """Return one station's ground truth; None if it is missing or fitted to a log."""
    setup, radio = problem.channel.truth, problem.stations[station]
    if isinstance(setup, RasterTruth):
        setup = raster_truth_of(setup, radio)
        gain = read_raster(setup.file, setup.variable, setup.origin_deg)
        _require_quantity(setup, gain)
        if setup.quantity == "power":
            gain = replace(gain, values=gain.values - radio.transmit_power_dbm)
        # NaN marks missing values; they pass, as comparisons with NaN are false.
        if (np.abs(gain.values) > LARGEST_GAIN_DB).any():
            raise InputError(
                f"has values from {np.nanmin(gain.values):g} to {np.nanmax(gain.values):g}, "
                "which cannot be path gains in dB",
                file=setup.file,
                key=setup.variable,
                remedy=f"give path gains in dB of at most {LARGEST_GAIN_DB:g} in magnitude",
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
            parameters, problem.workspace.bounds_m, setup.cell_m, floor, generator, setup.multipath
        )
    if isinstance(setup, MeasuredTruth):
        log, bounds = log_of(setup.log, radio), problem.workspace.bounds_m
        readings = read_log(log.file, log.log_format)
        truth = measured_truth(readings, bounds, setup.cell_m, setup.within_m)
        if np.isnan(truth.raster.values).all():
            raise InputError(
                f"has no reading within {setup.within_m:g} m of the workspace",
                file=log.file,
                key="channel.truth.file",
                remedy="check world.bounds_m, the columns and the filter `where`",
            )
        return truth
    if isinstance(setup, ArrayTruth | FunctionTruth):
        return _python_truth(problem, setup, station)
    return None


def _require_quantity(setup: RasterTruth, raster: Raster) -> None:
    """Raise an InputError if a map contains a quantity other than the declared one."""
    other = {"gain": "dBm", "power": "dB"}[setup.quantity]
    spread = raster.quantity.startswith("standard deviation")
    if raster.unit not in (other, "1") and not spread:
        return
    remedy = "name a variable with path gain in dB or received power in dBm"
    if raster.unit == other and not spread:
        remedy = f'set channel.truth.quantity = "{"power" if other == "dBm" else "gain"}"'
    raise InputError(
        f"has {raster.quantity or 'values'} in {raster.unit}, but channel.truth.quantity is "
        f"{setup.quantity!r}",
        file=setup.file,
        key=setup.variable,
        remedy=remedy,
    )


def _python_truth(problem: Problem, setup: ArrayTruth | FunctionTruth, station: int) -> Truth:
    """Return a station's ground truth from user-defined arrays or a function of position."""
    if isinstance(setup, ArrayTruth):
        x, y, values = (_numbers(key, getattr(setup, key)) for key in ("x_m", "y_m", "power_dbm"))
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
                f"returned shape {values.shape} for {len(places)} positions",
                key="channel.truth.power_dbm",
                remedy="return one power for each position: shape (n,) or (stations, n)",
            )
        values = values.reshape(*values.shape[:-1], len(y), len(x))
    if several != (len(problem.stations) > 1) or (several and len(values) != len(problem.stations)):
        raise InputError(
            f"has shape {values.shape}, but the number of stations is {len(problem.stations)}",
            key="channel.truth.power_dbm",
            remedy="give the power of each station: an array (stations, ny, nx), or a function "
            "that returns (stations, n)",
        )
    truth = power_truth(x, y, values[station] if several else values, setup.floor_dbm)
    least, largest = float(truth.raster.values.min()), float(truth.raster.values.max())
    if least < LEAST_POWER_DBM or largest > LARGEST_POWER_DBM:
        raise InputError(
            f"has powers from {least:g} to {largest:g}, outside {LEAST_POWER_DBM:g} to "
            f"{LARGEST_POWER_DBM:g} dBm",
            key="channel.truth.power_dbm",
            remedy="give powers in dBm; give NaN and floor_dbm where there is no signal",
        )
    return truth


def _numbers(key: str, values: object) -> Floats:
    """Return `values` as an array of real numbers, or raise an InputError that names `key`."""
    try:
        found = np.asarray(values)
        # NumPy would parse text as numbers and drop imaginary parts.
        if found.dtype.kind in "iufO":
            return found.astype(np.float64)
        kind = "text" if found.dtype.kind in "US" else f"numbers of type {found.dtype}"
    except (TypeError, ValueError):
        kind = type(values).__name__
    raise InputError(
        f"is {kind}, should be an array of real numbers",
        key=f"channel.truth.{key}",
        remedy="give e.g. numpy.full(len(places_m), -60.0)",
    )


def with_measurements(
    problem: Problem, measurements: UserMeasurements | None
) -> tuple[Problem, tuple[Measurements, ...] | None]:
    """Return a problem without measurements, and the user's measurements by station, if any."""
    # Without user measurements, return the unchanged problem and None.
    if measurements is None:
        return problem, None
    by_station = measurements_by_station(problem, measurements)
    bare = tuple(
        replace(station, log_file=None, power_column=None, censored_column=None, transmitter=None)
        for station in problem.stations
    )
    channel = replace(problem.channel, measurements=SampledMeasurements())
    return replace(problem, stations=bare, channel=channel), by_station


def measurements_by_station(
    problem: Problem, measurements: UserMeasurements
) -> tuple[Measurements, ...]:
    """Return the user's measurements as one table per station."""
    if isinstance(measurements, str | bytes | Path):
        raise InputError(
            f"is {measurements!r}, which is not a table of measurements",
            key="measurements",
            remedy="read a file with planopt.channel.read_log, or name it in "
            "channel.measurements.file",
        )
    tables = list(measurements) if isinstance(measurements, Sequence) else [measurements]
    if len(tables) != len(problem.stations):
        raise InputError(
            f"has {len(tables)} tables, but the number of stations is {len(problem.stations)}",
            key="measurements",
            remedy="give a list with one table for each station, in the order of the problem",
        )
    return tuple(as_received(table) for table in tables)


def learn(problem: Problem, measurements: Measurements, station: int = 0) -> Belief:
    """Return the belief about one station's channel, fitted to measurements."""
    site = problem.stations[station].site
    if problem.channel.given is not None:
        fit, posterior = _given(problem, problem.channel.given, measurements, station)
    else:
        fit = fit_channel(measurements, site, problem.channel.fit_method)
        # The times of planned measurements are unknown: all multipath is white to a plan.
        fit = replace(fit, parameters=replace(fit.parameters, lasting=None))
        posterior = condition(fit.parameters, measurements)
    return Belief(fit, posterior)


def _given(
    problem: Problem, known: GivenParameters, measurements: Measurements, station: int
) -> tuple[ChannelFit, ChannelPosterior]:
    """Return fit and posterior for known parameters; unknown path-loss parameters are fitted."""
    radio = problem.stations[station]
    path_loss_known = known.k_pl_db is not None
    parameters = ChannelParameters(
        k_pl_db=(known.k_pl_db or 0.0) + radio.transmit_power_dbm,
        n_pl=PRIOR_N_PL if known.n_pl is None else known.n_pl,
        shadow_std_db=known.shadow_std_db,
        decorrelation_m=known.decorrelation_m,
        multipath_std_db=known.multipath_std_db,
        station=radio.site,
    )
    posterior = condition(
        parameters, measurements, theta="known" if path_loss_known else "estimated"
    )
    if not path_loss_known:
        theta = posterior.theta
        parameters = replace(parameters, k_pl_db=float(theta[0]), n_pl=float(theta[1]))
        posterior = condition(parameters, measurements)
    errors = dict.fromkeys((each.name for each in fields(known)), 0.0)
    deviation = np.sqrt(np.diag(posterior.theta_covariance))
    errors |= {"k_pl_db": float(deviation[0]), "n_pl": float(deviation[1])}
    fit = ChannelFit(
        method="given",
        status="ok",
        parameters=parameters,
        standard_errors=errors,
        theta_covariance=posterior.theta_covariance,
        measurements=len(measurements),
        censored=int(measurements.censored.sum()),
        warnings=(),
        log_likelihood=None,
    )
    return fit, posterior


def learn_stations(problem: Problem, measurements: Sequence[Measurements]) -> Belief:
    """Return the belief about all stations' channels, each fitted to its own measurements."""
    beliefs = [learn(problem, own, station) for station, own in enumerate(measurements)]
    return replace(beliefs[0], further=tuple(beliefs[1:]))


def initial_belief(problem: Problem, seed: int = 0) -> Belief:
    """Return the belief before the first step, from logs or simulated measurements."""
    if isinstance(problem.channel.measurements, LoggedMeasurements):
        problem = replace(problem, channel=replace(problem.channel, truth=None))
    return learn_stations(problem, draw_initial_data(problem, seed).measurements)


@dataclass(frozen=True)
class Prepared:
    """Data shared by all runs of a seed: ground truth of each station, and initial belief."""

    truths: tuple[Truth, ...]  # Empty if the problem has none
    belief: Belief


@one_blas_thread()
def prepare(
    problem: Problem, seed: int, measurements: Sequence[Measurements] | None = None
) -> Prepared:
    """Return the initial data of a seed and the belief fitted to the initial measurements."""
    data = draw_initial_data(problem, seed, measurements)
    return Prepared(data.truths, learn_stations(problem, data.measurements))
