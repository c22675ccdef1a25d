"""The channel as it is. Only the simulator touches it; planners know a posterior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.channel.fields.field import conditional_field, shadow_field_db
from planopt.channel.fields.multipath import Lognormal, Multipath, multipath_field_db
from planopt.channel.measurements import MAX_POWER_DB, Measurements
from planopt.channel.parameters import ChannelParameters, regressors
from planopt.channel.places import require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.short_repr import short_repr
from planopt.world.raster import Raster, cell_centres_m, checked_raster, nearest_cells


@dataclass(frozen=True, eq=False)
class Truth:
    """Received power everywhere, fading included, so that a place keeps its value.

    Attributes
    ----------
    raster
        Power in dBm at cell centres; read at the nearest cell.
    floor_dbm
        The receiver's floor: no value is below it. None for none.
    mean_dbm
        ``[iy, ix]`` the power without small-scale fading, in the same cells.
    """

    raster: Raster
    floor_dbm: float | None
    mean_dbm: NDArray[np.float64]

    __repr__ = short_repr


def raster_truth(
    path_gain: Raster,
    transmit_power_dbm: float,
    floor_gain_db: float,
    multipath: Multipath | None,
    generator: np.random.Generator,
) -> Truth:
    """Truth from a map of path gains, such as a ray tracer's.

    Parameters
    ----------
    path_gain
        Gains in dB; NaN where nothing arrives.
    transmit_power_dbm
        Added to the gains.
    floor_gain_db
        The receiver's floor as a gain; smaller ones, fading included, are clipped to it.
    multipath
        The fading drawn for each cell, or None for none.
    generator
        Source of the fading.
    """
    gain = np.asarray(path_gain.values, dtype=np.float64)
    # fmax prefers the floor to NaN.
    mean = np.fmax(gain, floor_gain_db) + transmit_power_dbm
    if multipath is not None:
        gain = gain + multipath_field_db(gain.shape, multipath, generator)
    power = np.fmax(gain, floor_gain_db) + transmit_power_dbm
    floor_dbm = floor_gain_db + transmit_power_dbm
    return Truth(Raster(path_gain.x_m, path_gain.y_m, power), floor_dbm, mean)


def model_truth(
    parameters: ChannelParameters,
    bounds_m: tuple[float, float, float, float],
    cell_m: float,
    floor_dbm: float | None,
    generator: np.random.Generator,
    multipath: Multipath | None = None,
) -> Truth:
    """Truth drawn from the channel model itself (equation 1.1).

    Parameters
    ----------
    parameters
        Path loss, shadowing and multipath, one value a cell.
    bounds_m
        ``(x_min, y_min, x_max, y_max)``, covered by whole cells from the lower left.
    cell_m
        Cell side.
    floor_dbm
        The receiver's floor, or None for none.
    generator
        Source of shadowing and multipath.
    multipath
        Its law; None for one that is Gaussian in dB, with the parameters' deviation.
    """
    x_min, y_min, x_max, y_max = bounds_m
    x, y = cell_centres_m(x_min, x_max, cell_m), cell_centres_m(y_min, y_max, cell_m)
    shape = (len(y), len(x))
    centres = np.stack(np.meshgrid(x, y), axis=-1)
    power = regressors(centres, parameters.station) @ np.array(
        [parameters.k_pl_db, parameters.n_pl]
    )
    power += shadow_field_db(
        shape, cell_m, parameters.shadow_std_db, parameters.decorrelation_m, generator
    ).values_db
    law = Lognormal(parameters.multipath_std_db) if multipath is None else multipath
    return _faded(Raster(x, y, power), law, floor_dbm, generator)


def fitted_truth(
    posterior: ChannelPosterior,
    bounds_m: tuple[float, float, float, float],
    cell_m: float,
    floor_dbm: float | None,
    generator: np.random.Generator,
) -> Truth:
    """Draw the truth from the posterior of measurements; parameters as of :func:`model_truth`."""
    mean = conditional_field(posterior, bounds_m, cell_m, generator)
    return _faded(mean, Lognormal(posterior.parameters.multipath_std_db), floor_dbm, generator)


def _faded(
    mean: Raster, law: Multipath, floor_dbm: float | None, generator: np.random.Generator
) -> Truth:
    """Add multipath to a raster of powers, and apply the receiver's floor."""
    power = mean.values
    faded = power + multipath_field_db(power.shape, law, generator)
    if floor_dbm is not None:
        power, faded = np.maximum(power, floor_dbm), np.maximum(faded, floor_dbm)
    return Truth(Raster(mean.x_m, mean.y_m, faded), floor_dbm, power)


def power_truth(
    x_m: NDArray[np.float64],
    y_m: NDArray[np.float64],
    power_dbm: NDArray[np.float64],  # (ny, nx), NaN where nothing arrives
    floor_dbm: float | None = None,
) -> Truth:
    """Truth from arrays of received power, small-scale fading included or not."""
    # Shapes: x_m, y_m (nx,).
    raster = checked_raster(x_m, y_m, power_dbm, None, "power_dbm")
    if floor_dbm is not None and not abs(floor_dbm) <= MAX_POWER_DB:
        raise InputError(f"is {floor_dbm!r}, which is no power", key="floor_dbm", remedy="give dBm")
    if floor_dbm is None and np.isnan(raster.values).any():
        raise InputError(
            "is not finite somewhere",
            key="power_dbm",
            remedy="give floor_dbm, the least power that the receiver reports",
        )
    power = raster.values if floor_dbm is None else np.fmax(raster.values, floor_dbm)
    if not (np.abs(power) <= MAX_POWER_DB).all():
        raise InputError("is no power in dBm somewhere", key="power_dbm", remedy="give dBm")
    return Truth(Raster(raster.x_m, raster.y_m, power), floor_dbm, power)


def true_power_dbm(truth: Truth, positions_m: ArrayLike) -> NDArray[np.float64]:
    """Received power at `positions_m` (n, 2), in dBm, at least the floor; ``(n,)``."""
    iy, ix = nearest_cells(truth.raster, require_places(positions_m, at_least=0))
    return truth.raster.values[iy, ix]


def mean_power_dbm(truth: Truth, positions_m: ArrayLike) -> NDArray[np.float64]:
    """Received power without small-scale fading at `positions_m` (n, 2), in dBm; ``(n,)``."""
    iy, ix = nearest_cells(truth.raster, require_places(positions_m, at_least=0))
    return truth.mean_dbm[iy, ix]


def measure(truth: Truth, positions_m: ArrayLike) -> Measurements:
    """Measure the true power at `positions_m` (n, 2); values at the floor are censored."""
    power = true_power_dbm(truth, positions_m)
    censored = np.zeros(len(power), dtype=bool)
    if truth.floor_dbm is not None:
        censored = power <= truth.floor_dbm
    return Measurements(np.array(positions_m, dtype=np.float64), power, censored)
