"""The belief about the channel as ``belief.npz``: measurements, parameters and their origin.

Measurements are in the order taken. The arrays of the first station have plain names; those of
further stations begin with ``stations[1].`` and so on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.errors import InputError
from planopt.files.npz import read_npz
from planopt.files.tables import LARGEST, REMEDY
from planopt.files.whole import write_whole

if TYPE_CHECKING:
    from planopt.planning.run import Run

BELIEF_FILE = "belief.npz"

PARAMETER_NAMES = ("k_pl_db", "n_pl", "shadow_std_db", "decorrelation_m", "multipath_std_db")
"""Order of the arrays ``parameters`` and ``standard_errors``."""

KINDS = {"censored": "b", "receiver": "iu", "first_measurements": "iu", "known_before_step": "iu"}
"""Kinds of data type of arrays that do not have floating-point numbers."""

NOT_NEGATIVE = ("resolution_db", "position_std_m", "noise_variance_db2", "first_measurements")

UNLIMITED = ("values_db", "forgetting_s")
"""Arrays whose numbers may be larger than `LARGEST`."""

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class SavedBelief:
    """A belief as it stands in its file."""

    file: Path  # The file
    parameters: ChannelParameters  # As fitted from the first measurements
    measurements: Measurements  # All, in the order taken
    first: int  # How many of them the fit and the first posterior rest on
    # (steps,) how many were known when each step of a run was planned; empty for a plan
    known_before_step: NDArray[np.int64]
    arrays: Mapping[str, NDArray[Any]]  # All that the file has, by name
    further: tuple[SavedBelief, ...] = ()  # Of each further station, in the problem's order

    @property
    def stations(self) -> tuple[SavedBelief, ...]:
        """Return what there is of each station, the first one's first."""
        return (self, *self.further)


def station_prefix(station: int) -> str:
    """Return what names of a station's arrays begin with."""
    return f"stations[{station}]." if station else ""


def write(path: Path, arrays: Arrays) -> None:
    """Save arrays, whole or not at all."""

    def write_to(temporary: Path) -> None:
        np.savez_compressed(temporary, allow_pickle=False, **arrays)

    write_whole(path, write_to)


def belief_of_plan(belief: Belief) -> Arrays:
    """Return the arrays of what a plan was made from."""
    return _of_stations(belief, lambda _own, _first: np.zeros(0, dtype=np.int64))


def beliefs_of_run(run: Run) -> list[Arrays]:
    """Return the arrays of each robot's belief, with what was known before each step."""
    tracks = [one.log.positions_m for one in run.runs]
    shared = run.problem.channel.share_measurements
    return [
        _of_stations(
            belief,
            partial(known_before_steps, tracks_m=tracks if shared else [track]),
        )
        for belief, track in zip(run.beliefs, tracks, strict=True)
    ]


def _of_stations(belief: Belief, known: Callable[[Belief, int], NDArray[np.int64]]) -> Arrays:
    return {
        station_prefix(station) + name: array
        for station, own in enumerate((belief, *belief.further))
        for name, array in belief_arrays(own, known(own, own.fit.measurements)).items()
    }


def known_before_steps(
    belief: Belief,
    first: int,
    tracks_m: Sequence[NDArray[np.float64]],  # (steps + 1, 2) each
) -> NDArray[np.int64]:
    """Return how many measurements each step was planned on; ``(steps,)``.

    Measurements of the run are taken at the places driven to, in order, each place at most once
    a visit; so going along both finds the step of each.
    """
    taken = belief.posterior.measurements.positions_m
    count = first
    known: list[int] = []
    for places in list(zip(*tracks_m, strict=True))[1:]:
        known.append(count)
        for place in places:
            if count < len(taken) and np.array_equal(taken[count], place):
                count += 1
    return np.array(known, dtype=np.int64)


def belief_arrays(belief: Belief, known_before_step: NDArray[np.int64]) -> Arrays:
    """Return the arrays of one station."""
    fit, posterior = belief.fit, belief.posterior
    measurements, station = posterior.measurements, fit.parameters.station
    return {
        **{column.name: getattr(measurements, column.name) for column in fields(Measurements)},
        "parameters": np.array([getattr(fit.parameters, name) for name in PARAMETER_NAMES]),
        "forgetting_s": np.array(fit.parameters.forgetting_s),
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


def read_belief(path: Path, stations: int = 1) -> SavedBelief:
    """Read the belief about so many stations."""
    try:
        arrays = read_npz(path)
    except InputError as error:
        raise error.remedied(REMEDY) from None
    found: list[SavedBelief] = []
    for station in reversed(range(stations)):
        prefix = station_prefix(station)
        own = {name: array for name, array in arrays.items() if name.startswith(prefix)}
        arrays = {name: array for name, array in arrays.items() if name not in own}
        own = {name.removeprefix(prefix): array for name, array in own.items()}
        found.append(_station(path, prefix, own))
    return replace(found[-1], further=tuple(found[-2::-1]))


def _station(path: Path, prefix: str, arrays: Arrays) -> SavedBelief:
    """Return what the file says of one station."""

    def fault(name: str, message: str) -> InputError:
        return InputError(message, file=path, key=prefix + name, remedy=REMEDY)

    def array(name: str, *shape: int | None) -> NDArray[Any]:
        if name not in arrays:
            raise fault(name, "the array is missing")
        found = arrays[name]
        fits = found.ndim == len(shape) and all(
            wanted in (None, size) for size, wanted in zip(found.shape, shape, strict=True)
        )
        if not fits or found.dtype.kind not in KINDS.get(name, "f"):
            message = f"an array of shape {found.shape} and type {found.dtype} does not fit"
            raise fault(name, message)
        if name not in UNLIMITED and not (np.abs(found) <= LARGEST).all():
            raise fault(name, "a number is not finite or too large")
        if np.isnan(found).any() or (name in NOT_NEGATIVE and (found < 0).any()):
            raise fault(name, "a number is negative or missing")
        return found

    count = len(array("power_dbm", None))
    columns = {
        column.name: array(column.name, count, *((2,) if column.name == "positions_m" else ()))
        for column in fields(Measurements)
    }
    numbers = array("parameters", len(PARAMETER_NAMES)).tolist()
    if numbers[3] <= 0.0 or numbers[2] < 0.0 or numbers[4] < 0.0:
        raise fault("parameters", f"{numbers} are no channel parameters")
    forgetting_s = float(array("forgetting_s"))
    if forgetting_s <= 0.0:
        raise fault("forgetting_s", f"{forgetting_s!r} is no forgetting time")
    if not (array("noise_variance_db2", count) > 0.0).all():
        raise fault("noise_variance_db2", "a variance is not positive")
    array("values_db", count)
    x, y, height = array("station", 3).tolist()
    first, known = int(array("first_measurements")), array("known_before_step", None)
    if (np.diff([first, *known.tolist(), count]) < 0).any():
        message = f"counts do not grow from {first} to {count} measurements"
        raise fault("known_before_step", message)
    return SavedBelief(
        file=path,
        parameters=ChannelParameters(
            *numbers, station=Station((x, y), height), forgetting_s=forgetting_s
        ),
        measurements=Measurements(**columns),
        first=first,
        known_before_step=known.astype(np.int64),
        arrays=arrays,
    )
