"""What was known of the channel, as ``belief.npz``: measurements, parameters and how they came.

A posterior is rebuilt by conditioning again on the saved measurements, in the order taken and in
the portions taken, because a censored measurement's Gaussian site depends on what was known when
it came. The sites and theta are saved too, so that a file that contradicts itself is found.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import ChannelPosterior, condition, extend
from planopt.errors import InputError
from planopt.files import write_whole
from planopt.planning.solution_json import LARGEST

PARAMETER_NAMES = ("k_pl_db", "n_pl", "shadow_std_db", "decorrelation_m", "multipath_std_db")
"""Order of the arrays ``parameters`` and ``standard_errors``."""

SITE_TOLERANCE = 1e-5
"""Sites come from an iteration that stops at 1e-7, theta from round-off; natural units of each."""

_REMEDY = "save the plan or run again"


@dataclass(frozen=True, eq=False)
class SavedBelief:
    """A belief as it stands in its file.

    Attributes
    ----------
    file
        The file.
    parameters
        As fitted from the first measurements.
    measurements
        All, in the order taken.
    first
        How many of them the fit and the first posterior rest on.
    known_before_step
        ``(steps,)`` how many were known when each step of a run was planned; empty for a plan.
    theta_known
        Whether theta was given rather than estimated.
    values_db, noise_variance_db2
        ``(kappa,)`` the Gaussian measurements that stood for them.
    theta
        ``(2,)`` (K_PL, n_PL) from all.
    """

    file: Path
    parameters: ChannelParameters
    measurements: Measurements
    first: int
    known_before_step: NDArray[np.int64]
    theta_known: bool
    values_db: NDArray[np.float64]
    noise_variance_db2: NDArray[np.float64]
    theta: NDArray[np.float64]


def write_belief(path: Path, belief: Belief, known_before_step: NDArray[np.int64]) -> None:
    """Save a belief, whole or not at all.

    Parameters
    ----------
    path
        Ends in ``.npz``.
    belief
        At the end of the run, or of the plan.
    known_before_step
        ``(steps,)`` how many measurements each step was planned on; empty for a plan.
    """
    fit, posterior = belief.fit, belief.posterior
    parameters, measurements = posterior.parameters, posterior.measurements
    station = parameters.station
    arrays: dict[str, Any] = {
        "positions_m": measurements.positions_m,
        "power_dbm": measurements.power_dbm,
        "censored": measurements.censored,
        "parameters": np.array([getattr(parameters, name) for name in PARAMETER_NAMES]),
        "station": np.array([*station.position_m, station.height_m]),
        "first_measurements": np.array(fit.measurements),
        "known_before_step": known_before_step,
        "theta": posterior.theta,
        "theta_covariance": posterior.theta_covariance,
        "theta_known": np.array(posterior.theta_known),
        "values_db": posterior.values_db,
        "noise_variance_db2": posterior.noise_variance_db2,
        "standard_errors": np.array([fit.standard_errors[name] for name in PARAMETER_NAMES]),
        "fit_method": np.array(fit.method),
        "fit_status": np.array(fit.status),
        "fit_warnings": np.array(fit.warnings, dtype=np.str_),
    }

    def write(temporary: Path) -> None:
        np.savez_compressed(temporary, allow_pickle=False, **arrays)

    write_whole(path, write)


def read_belief(path: Path) -> SavedBelief:
    """Read what :func:`write_belief` wrote.

    Raises
    ------
    InputError
        The file is missing, truncated or no ``npz``, or an array is missing, of the wrong shape
        or impossible; with the file and the array's name as the key.
    """
    arrays = _Arrays(path, _read_arrays(path))
    power = arrays.floats("power_dbm", None)
    count = len(power)
    positions = arrays.floats("positions_m", (count, 2))
    censored = arrays.of_kind("censored", "b", (count,)).astype(np.bool_)
    numbers = arrays.floats("parameters", (len(PARAMETER_NAMES),))
    x, y, height = (float(v) for v in arrays.floats("station", (3,)))
    if numbers[3] <= 0.0 or numbers[2] < 0.0 or numbers[4] < 0.0:
        raise arrays.error("parameters", f"{numbers.tolist()} are no channel parameters")
    known = arrays.of_kind("known_before_step", "iu", None).astype(np.int64)
    first = int(arrays.of_kind("first_measurements", "iu", ()))
    steps = np.array([first, *known, count])
    if first < 0 or (np.diff(steps) < 0).any():
        raise arrays.error(
            "known_before_step", f"counts do not grow from {first} to {count} measurements"
        )
    return SavedBelief(
        file=path,
        parameters=ChannelParameters(
            *(float(number) for number in numbers), station=Station((x, y), height)
        ),
        measurements=Measurements(positions, power, censored),
        first=first,
        known_before_step=known,
        theta_known=bool(arrays.of_kind("theta_known", "b", ())),
        values_db=arrays.floats("values_db", (count,), largest=np.inf),
        noise_variance_db2=arrays.floats("noise_variance_db2", (count,)),
        theta=arrays.floats("theta", (2,)),
    )


def first_posterior(saved: SavedBelief) -> ChannelPosterior:
    """What was believed before the first step."""
    return condition(
        saved.parameters,
        _part(saved.measurements, 0, saved.first),
        theta="known" if saved.theta_known else "estimated",
    )


def grown_posterior(
    saved: SavedBelief, posterior: ChannelPosterior, count: int
) -> ChannelPosterior:
    """`posterior` extended to the first `count` measurements of the file."""
    return extend(posterior, _part(saved.measurements, len(posterior.measurements), count))


def contradictions(saved: SavedBelief, posterior: ChannelPosterior) -> list[str]:
    """Where the saved sites and theta are not those of the rebuilt `posterior` of all."""
    found: list[str] = []
    precision, saved_precision = 1.0 / posterior.noise_variance_db2, 1.0 / saved.noise_variance_db2
    differs = ~np.isclose(
        saved_precision, precision, rtol=SITE_TOLERANCE, atol=SITE_TOLERANCE
    ) | ~np.isclose(
        saved.values_db * saved_precision,
        posterior.values_db * precision,
        rtol=SITE_TOLERANCE,
        atol=SITE_TOLERANCE,
    )
    if differs.any():
        found.append(
            f"{saved.file.name}: measurement {int(np.argmax(differs))} does not give the saved "
            "values_db and noise_variance_db2"
        )
    if not np.allclose(saved.theta, posterior.theta, rtol=SITE_TOLERANCE, atol=SITE_TOLERANCE):
        found.append(f"{saved.file.name}: the measurements do not give the saved theta")
    return found


def _part(measurements: Measurements, start: int, stop: int) -> Measurements:
    return Measurements(
        measurements.positions_m[start:stop],
        measurements.power_dbm[start:stop],
        measurements.censored[start:stop],
    )


@dataclass(frozen=True)
class _Arrays:
    """The arrays of a file, asked for by name."""

    path: Path
    arrays: Mapping[str, NDArray[Any]]

    def error(self, name: str, message: str) -> InputError:
        return InputError(message, file=self.path, key=name, remedy=_REMEDY)

    def of_kind(self, name: str, kinds: str, shape: tuple[int, ...] | None) -> NDArray[Any]:
        """An array of one of the dtype `kinds` and of `shape`, None for any one dimension."""
        if name not in self.arrays:
            raise self.error(name, "the array is missing")
        array = self.arrays[name]
        fits = array.ndim == 1 if shape is None else array.shape == shape
        if not fits or array.dtype.kind not in kinds:
            raise self.error(
                name, f"an array of shape {array.shape} and type {array.dtype} does not fit"
            )
        return array

    def floats(
        self, name: str, shape: tuple[int, ...] | None, largest: float = LARGEST
    ) -> NDArray[np.float64]:
        """Finite numbers of magnitude at most `largest`."""
        array = self.of_kind(name, "f", shape).astype(np.float64)
        if not (np.isfinite(array) & (np.abs(array) <= largest)).all():
            raise self.error(name, "a number is not finite or too large")
        return array


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        # Opened here, because NumPy leaves its own handle open on a damaged archive.
        with path.open("rb") as stream:
            loaded = np.load(stream, allow_pickle=False)
            if not isinstance(loaded, np.lib.npyio.NpzFile):
                raise InputError("is not an npz archive", file=path, remedy=_REMEDY)
            archive = cast("Mapping[str, NDArray[Any]]", loaded)
            return {name: archive[name] for name in archive}
    except OSError as error:
        raise InputError(
            f"cannot be read: {error.strerror or error}", file=path, remedy=_REMEDY
        ) from None
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error, KeyError) as error:
        raise InputError(f"is damaged: {error}", file=path, remedy=_REMEDY) from None
