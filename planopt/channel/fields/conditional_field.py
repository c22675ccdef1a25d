"""Fields that agree with measurements: draws from the posterior, by kriging the residual.

An unconditional field is drawn at the places and at the measurements alike; what it misses of the
measured values is kriged and added. Mean and covariance of the result are those of the posterior
(conditioning by kriging), at the cost of one kriging for each draw and no covariance between
places. Drawn fields are of one time and at known places, so that measurements of a channel that
forgets, or with errors of position, cannot be had here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import solve_upper
from planopt.channel.factor import whiten
from planopt.channel.fields.field import shadow_field_db
from planopt.channel.fields.scattered_field import added_to_lattice_db, scattered_field_db
from planopt.channel.kernel import shadow_covariance_db2
from planopt.channel.kriging import PREDICTION_ELEMENTS
from planopt.channel.mean_model import regressors
from planopt.channel.measurement_covariance import RECEIVER_OFFSET_STD_DB
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.world.raster import Raster, cell_centres_m


@one_blas_thread()
def conditional_field(
    posterior: ChannelPosterior,
    bounds_m: tuple[float, float, float, float],
    cell_m: float,
    generator: np.random.Generator,
) -> Raster:
    """Draw path loss and shadowing on a lattice, given the measurements; no multipath.

    Parameters
    ----------
    posterior
        The channel given measurements. Where theta is estimated it is drawn too.
    bounds_m
        ``(x_min, y_min, x_max, y_max)``, covered by whole cells from the lower left.
    cell_m
        Cell side.
    generator
        Source of randomness.

    Raises
    ------
    InputError
        The lattice is too large for its decorrelation distance, or the channel forgets, or the
        measurements have errors of position.
    """
    _require_one_time_and_known_places(posterior)
    parameters = posterior.parameters
    x_min, y_min, x_max, y_max = bounds_m
    x, y = cell_centres_m(x_min, x_max, cell_m), cell_centres_m(y_min, y_max, cell_m)
    covariance = (parameters.shadow_std_db, parameters.decorrelation_m)
    lattice = shadow_field_db((y.size, x.size), cell_m, *covariance, generator).values_db
    measured = posterior.measurements.positions_m
    at_measured = added_to_lattice_db(x, y, lattice, measured, *covariance, generator)
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    values = _conditioned(posterior, centres, lattice.ravel(), at_measured, generator)
    return Raster(x, y, values.reshape(lattice.shape))


@one_blas_thread()
def conditional_values_db(
    posterior: ChannelPosterior, positions_m: NDArray[np.float64], generator: np.random.Generator
) -> NDArray[np.float64]:
    """Draw path loss and shadowing at any places, given the measurements; no multipath.

    Parameters
    ----------
    posterior
        The channel given measurements. Where theta is estimated it is drawn too.
    positions_m
        ``(n, 2)``.
    generator
        Source of randomness.

    Returns
    -------
    NDArray
        ``(n,)`` in dBm.

    Raises
    ------
    InputError
        Places and measurements together are too many for an exact field, or the channel forgets, or
        the measurements have errors of position.
    """
    _require_one_time_and_known_places(posterior)
    together = np.concatenate([positions_m, posterior.measurements.positions_m])
    parameters = posterior.parameters
    drawn = scattered_field_db(
        together, parameters.shadow_std_db, parameters.decorrelation_m, generator
    )
    count = len(positions_m)
    return _conditioned(posterior, positions_m, drawn[:count], drawn[count:], generator)


def _conditioned(
    posterior: ChannelPosterior,
    places_m: NDArray[np.float64],
    at_places_db: NDArray[np.float64],
    at_measured_db: NDArray[np.float64],
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Power gamma theta + s + phi' U^-1 (y - Gamma theta - s_measured - noise), theta drawn."""
    station, measured = posterior.parameters.station, posterior.measurements.positions_m
    theta = generator.multivariate_normal(
        posterior.theta, posterior.theta_covariance, method="eigh"
    )
    noise = np.sqrt(posterior.noise_variance_db2) * generator.standard_normal(len(measured))
    missed = posterior.values_db - regressors(measured, station) @ theta - at_measured_db - noise
    received = posterior.measurements.receiver
    if received.any():
        numbers, which = np.unique(received, return_inverse=True)
        offsets = RECEIVER_OFFSET_STD_DB * generator.standard_normal(len(numbers))
        missed -= np.where(received == 0, 0.0, offsets[which])
    weights = solve_upper(posterior.factor, whiten(posterior.factor, missed[:, None])[:, 0])
    values = at_places_db + regressors(places_m, station) @ theta
    block = max(1, PREDICTION_ELEMENTS // max(1, len(measured)))
    for start in range(0, len(places_m), block):
        part = slice(start, start + block)
        values[part] += (
            shadow_covariance_db2(places_m[part], measured, posterior.parameters) @ weights
        )
    return values


def _require_one_time_and_known_places(posterior: ChannelPosterior) -> None:
    """Refuse what a field drawn in the plane cannot be conditioned on."""
    origins = posterior.origins
    for part, what in ((origins.time_s, "that age"), (origins.blur_m2, "at uncertain places")):
        if part is not None:
            raise InputError(
                f"fields are not drawn given measurements {what}",
                key="posterior",
                remedy="use sample_power, for as many places as memory allows",
            )
