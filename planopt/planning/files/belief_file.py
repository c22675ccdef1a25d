"""The belief about the channel as ``belief.npz``: measurements, parameters and their origin.

A posterior is rebuilt by conditioning again on the saved measurements, in the order taken and in
the portions taken, because a censored measurement's Gaussian site depends on what was known when
it came. The sites and theta are saved too, so that a file that contradicts itself is found.

The arrays of the first station have plain names; those of further stations begin with
``stations[1].`` and so on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
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


@dataclass(frozen=True)
class NpzArrays:
    """The arrays of a file, asked for by name; `prefix` is what stands before it in the file."""

    path: Path
    arrays: Mapping[str, NDArray[Any]]
    prefix: str = ""

    def within(self, prefix: str) -> NpzArrays:
        """Return the arrays whose names begin with `prefix`, asked for without it."""
        own = {
            name.removeprefix(prefix): array
            for name, array in self.arrays.items()
            if name.startswith(prefix)
        }
        return NpzArrays(self.path, own, prefix)

    def without(self, prefix: str) -> NpzArrays:
        """The others."""
        rest = {n: array for n, array in self.arrays.items() if not n.startswith(prefix)}
        return NpzArrays(self.path, rest, self.prefix)

    def error(self, name: str, message: str) -> InputError:
        """Return the error to raise if the array `name` cannot be used."""
        return InputError(message, file=self.path, key=self.prefix + name, remedy=REMEDY)

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


def saved_arrays(path: Path) -> NpzArrays:
    """Read every array of a file."""
    try:
        return NpzArrays(path, read_npz(path))
    except InputError as error:
        raise error.remedied(REMEDY) from None


BELIEF_FILE = "belief.npz"

PARAMETER_NAMES = ("k_pl_db", "n_pl", "shadow_std_db", "decorrelation_m", "multipath_std_db")
"""Order of the arrays ``parameters`` and ``standard_errors``."""

OPTIONAL_NAMES = ("resolution_db", "position_std_m", "time_s")
"""Of measurements, zero in files that lack them; as is ``receiver``."""


@dataclass(frozen=True, eq=False)
class SavedBelief:
    """A belief as it stands in its file."""

    file: Path  # The file
    parameters: ChannelParameters  # As fitted from the first measurements
    measurements: Measurements  # All, in the order taken
    first: int  # How many of them the fit and the first posterior rest on
    # (steps,) how many were known when each step of a run was planned; empty for a plan
    known_before_step: NDArray[np.int64]
    theta_known: bool  # Whether theta was given rather than estimated
    values_db: NDArray[np.float64]  # (kappa,) the Gaussian measurements that stood for them
    noise_variance_db2: NDArray[np.float64]
    arrays: Mapping[str, NDArray[Any]]  # All that the file has, by name
    further: tuple[SavedBelief, ...] = ()  # Of each further station, in the problem's order

    @property
    def stations(self) -> tuple[SavedBelief, ...]:
        """Return what there is of each station, the first one's first."""
        return (self, *self.further)


def station_prefix(station: int) -> str:
    """Return what names of a station's arrays begin with."""
    return f"stations[{station}]." if station else ""


Arrays = dict[str, NDArray[Any]]


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


def _of_stations(
    belief: Belief, known: Callable[[Belief, int], NDArray[np.int64]]
) -> dict[str, NDArray[Any]]:
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


def belief_arrays(belief: Belief, known_before_step: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """Return the arrays of one station."""
    fit, posterior = belief.fit, belief.posterior
    measurements = posterior.measurements
    return {
        "positions_m": measurements.positions_m,
        "power_dbm": measurements.power_dbm,
        "censored": measurements.censored,
        **{name: getattr(measurements, name) for name in OPTIONAL_NAMES},
        "receiver": measurements.receiver,
        **parameter_arrays(fit.parameters),
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


def parameter_arrays(parameters: ChannelParameters) -> dict[str, NDArray[Any]]:
    """Return the file's arrays of the channel's parameters."""
    station = parameters.station
    return {
        "parameters": np.array([getattr(parameters, name) for name in PARAMETER_NAMES]),
        "forgetting_s": np.array(parameters.forgetting_s),
        "station": np.array([*station.position_m, station.height_m]),
    }


def read_belief(path: Path, stations: int = 1) -> SavedBelief:
    """Read the belief about so many stations."""
    arrays = saved_arrays(path)
    further: list[SavedBelief] = []
    for station in range(1, stations):
        prefix = station_prefix(station)
        further.append(_saved(arrays.within(prefix)))
        arrays = arrays.without(prefix)
    return replace(_saved(arrays), further=tuple(further))


def _saved(arrays: NpzArrays) -> SavedBelief:
    """Return what the file says of one station."""
    power = arrays.floats("power_dbm", None)
    count = len(power)
    positions = arrays.floats("positions_m", (count, 2))
    censored = arrays.of_kind("censored", "b", (count,)).astype(np.bool_)
    numbers = arrays.floats("parameters", (len(PARAMETER_NAMES),))
    x, y, height = (float(v) for v in arrays.floats("station", (3,)))
    if numbers[3] <= 0.0 or numbers[2] < 0.0 or numbers[4] < 0.0:
        raise arrays.error("parameters", f"{numbers.tolist()} are no channel parameters")
    noise = arrays.floats("noise_variance_db2", (count,))
    if (noise <= 0.0).any():
        raise arrays.error("noise_variance_db2", "a variance is not positive")
    known = arrays.of_kind("known_before_step", "iu", None).astype(np.int64)
    first = int(arrays.of_kind("first_measurements", "iu", ()))
    steps = np.array([first, *known, count])
    if first < 0 or (np.diff(steps) < 0).any():
        raise arrays.error(
            "known_before_step", f"counts do not grow from {first} to {count} measurements"
        )
    return SavedBelief(
        file=arrays.path,
        parameters=ChannelParameters(
            *(float(number) for number in numbers),
            station=Station((x, y), height),
            forgetting_s=_forgetting_s(arrays),
        ),
        measurements=Measurements(positions, power, censored, **_optional(arrays, count)),
        first=first,
        known_before_step=known,
        theta_known=bool(arrays.of_kind("theta_known", "b", ())),
        values_db=arrays.floats("values_db", (count,), largest=np.inf),
        noise_variance_db2=noise,
        arrays=arrays.arrays,
    )


def _optional(arrays: NpzArrays, count: int) -> dict[str, NDArray[Any]]:
    """Return what measurements may have beside place, power and flag, and the file has."""
    found: dict[str, NDArray[Any]] = {
        name: arrays.floats(name, (count,)) for name in OPTIONAL_NAMES if name in arrays.arrays
    }
    for name in ("resolution_db", "position_std_m"):
        if name in found and (found[name] < 0.0).any():
            raise arrays.error(name, "a number is negative")
    if "receiver" in arrays.arrays:
        found["receiver"] = arrays.of_kind("receiver", "iu", (count,)).astype(np.intp)
    return found


def _forgetting_s(arrays: NpzArrays) -> float:
    """The forgetting time; infinite in files that lack it."""
    if "forgetting_s" not in arrays.arrays:
        return math.inf
    value = float(arrays.of_kind("forgetting_s", "f", ()))
    if not value > 0.0:
        raise arrays.error("forgetting_s", f"{value!r} is no forgetting time")
    return value
