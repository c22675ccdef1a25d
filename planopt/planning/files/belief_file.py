"""Arrays of saved results: beliefs in ``belief.npz``, certificates of bounds in ``bound.npz``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats
from planopt.bounds.bound import Potential, Tilts
from planopt.channel.estimation.fit import MAP_N_PL
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import Belief
from planopt.errors import InputError
from planopt.files.reading import read_npz
from planopt.files.tables import LARGEST, REMEDY
from planopt.planning.loop.results import Run
from planopt.planning.plan import Plan
from planopt.problems.tasks import Arrays

BELIEF_FILE = "belief.npz"

PARAMETER_NAMES = ("k_pl_db", "n_pl", "shadow_std_db", "decorrelation_m", "multipath_std_db")
"""Order of the parameters in the arrays ``parameters`` and ``standard_errors``."""
TINY = float(np.finfo(float).tiny)  # Smallest positive normal float


@dataclass(frozen=True)
class _Stored:
    """Expected dtype and shape of an array that is saved for each station."""

    name: str
    source: Callable[[Belief], object]
    # Sizes: None is any, "n" the number of measurements. Arrays without a shape are only compared
    shape: tuple[int | str | None, ...] | None = None
    kind: str = "f"  # NumPy kind codes of the data type
    least: float = -LARGEST
    largest: float = LARGEST


def _measurement(name: str) -> _Stored:
    return _Stored(
        name,
        lambda own: getattr(own.posterior.measurements, name),
        ("n", 2) if name == "positions_m" else ("n",),
        {"censored": "b", "receiver": "iu"}.get(name, "f"),
        0.0 if name in ("resolution_db", "position_std_m") else -LARGEST,
    )


def _parameters(values: Callable[[Belief, str], object]) -> Callable[[Belief], object]:
    return lambda own: [values(own, name) for name in PARAMETER_NAMES]


STORED = (
    *(_measurement(column.name) for column in fields(Measurements)),
    _Stored(
        "parameters",
        _parameters(lambda own, name: getattr(own.fit.parameters, name)),
        (len(PARAMETER_NAMES),),
    ),
    _Stored("forgetting_s", lambda own: own.fit.parameters.forgetting_s, (), "f", TINY, np.inf),
    _Stored(
        "station", lambda own: (*(at := own.fit.parameters.station).position_m, at.height_m), (3,)
    ),
    _Stored("first_measurements", lambda own: own.fit.measurements, (), "iu", 0.0),
    _Stored("theta", lambda own: own.posterior.theta),
    _Stored("theta_covariance", lambda own: own.posterior.theta_covariance),
    _Stored("theta_known", lambda own: own.posterior.theta_known),
    _Stored(
        "values_db", lambda own: own.posterior.values_db, ("n",), least=-np.inf, largest=np.inf
    ),
    _Stored("noise_variance_db2", lambda own: own.posterior.noise_variance_db2, ("n",), least=TINY),
    _Stored("standard_errors", _parameters(lambda own, name: own.fit.standard_errors[name])),
    _Stored("fit_method", lambda own: own.fit.method),
    _Stored("fit_status", lambda own: own.fit.status),
    _Stored("fit_warnings", lambda own: np.array(own.fit.warnings, dtype=np.str_)),
)
"""Arrays of a station, except for the measurement counts before each step."""

KNOWN = _Stored("known_before_step", lambda _: (), (None,), "iu")


@dataclass(frozen=True, eq=False)
class SavedBelief:
    """Belief about one station's channel, as read from its file."""

    file: Path  # The file
    parameters: ChannelParameters  # Parameters fitted to the initial measurements
    measurements: Measurements  # All measurements in chronological order
    first: int  # Number of measurements used by the fit and the first posterior
    # (steps,) number of measurements known when each step was planned; empty for a plan
    known_before_step: NDArray[np.int64]
    arrays: Mapping[str, NDArray[Any]]  # All arrays of the file by name
    further: tuple[SavedBelief, ...] = ()  # Beliefs of further stations, in the problem's order

    @property
    def stations(self) -> tuple[SavedBelief, ...]:
        """Return the beliefs about all stations, in the problem's order."""
        return (self, *self.further)


def station_prefix(station: int) -> str:
    """Return the prefix of a station's array names."""
    return f"stations[{station}]." if station else ""


def beliefs_of_run(run: Run) -> list[Arrays]:
    """Return the arrays to save for each robot's belief after a run."""
    tracks = [one.log.positions_m for one in run.runs]
    shared = run.problem.channel.share_measurements
    return [
        belief_arrays_of(
            belief, partial(known_before_steps, tracks_m=tracks if shared else [track])
        )
        for belief, track in zip(run.beliefs, tracks, strict=True)
    ]


def belief_arrays_of(
    belief: Belief,
    known: Callable[[Belief, int], NDArray[np.int64]] = lambda _own, _first: np.zeros(0, np.int64),
) -> Arrays:
    """Return a belief's arrays; `known` supplies the numbers of measurements before each step."""
    return {
        station_prefix(station) + name: array
        for station, own in enumerate((belief, *belief.further))
        for name, array in belief_arrays(own, known(own, own.fit.measurements)).items()
    }


def known_before_steps(belief: Belief, first: int, tracks_m: Sequence[Floats]) -> NDArray[np.int64]:
    """Return the number (steps,) of measurements known at the time of each plan."""
    # Shapes: tracks_m (steps + 1, 2), each.
    # Measurements of a run are taken at visited positions, in order, at most one per visit.
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
    """Return the arrays to save for the belief about one station."""
    arrays = {stored.name: np.asarray(stored.source(belief)) for stored in STORED}
    return {**arrays, KNOWN.name: known_before_step}


def read_belief(path: Path, stations: int = 1) -> SavedBelief:
    """Return the saved belief about `stations` stations."""
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
        found.append(_read_station(path, prefix, own))
    return replace(found[-1], further=tuple(found[-2::-1]))


def _read_station(path: Path, prefix: str, arrays: Arrays) -> SavedBelief:
    """Return the saved belief about one station, after validation."""

    def fault(name: str, message: str) -> InputError:
        return InputError(message, file=path, key=prefix + name, remedy=REMEDY)

    count = len(np.atleast_1d(arrays.get("power_dbm", np.zeros(0))))
    # Powers are read first because their length fixes the length of the other arrays.
    for stored in sorted((*STORED, KNOWN), key=lambda each: each.name != "power_dbm"):
        if stored.shape is None:
            continue
        if stored.name not in arrays:
            raise fault(stored.name, "is missing")
        found = arrays[stored.name]
        sizes = [count if size == "n" else size for size in stored.shape]
        _require_fit(path, prefix + stored.name, found, stored.kind, sizes)
        if not ((found >= stored.least) & (found <= stored.largest)).all():
            raise fault(stored.name, f"has a number outside {stored.least:g} to {stored.largest:g}")
    numbers = arrays["parameters"].tolist()
    if numbers[3] <= 0.0 or numbers[2] < 0.0 or numbers[4] < 0.0:
        raise fault("parameters", f"{numbers} are no channel parameters")
    x, y, height = arrays["station"].tolist()
    first, known = int(arrays["first_measurements"]), arrays[KNOWN.name].astype(np.int64)
    if (np.diff([first, *known.tolist(), count]) < 0).any():
        raise fault(KNOWN.name, f"counts do not grow from {first} to {count} measurements")
    return SavedBelief(
        file=path,
        parameters=ChannelParameters(
            *numbers,
            station=Station((x, y), height),
            forgetting_s=float(arrays["forgetting_s"]),
            n_pl_prior=MAP_N_PL if str(arrays.get("fit_method")) == "map" else None,
        ),
        measurements=Measurements(
            **{each.name: arrays[each.name] for each in fields(Measurements)}
        ),
        first=first,
        known_before_step=known,
        arrays=arrays,
    )


def _require_fit(
    path: Path, key: str, array: NDArray[Any], kinds: str, sizes: Sequence[object]
) -> None:
    """Raise an `InputError` unless an array has one of `kinds` and the `sizes` (None: any size)."""
    fits = array.ndim == len(sizes) and all(
        size in (None, own) for size, own in zip(sizes, array.shape, strict=True)
    )
    if not fits or array.dtype.kind not in kinds:
        message = f"an array of shape {array.shape} and type {array.dtype} does not fit"
        raise InputError(message, file=path, key=key, remedy=REMEDY)


BOUND_FILE = "bound.npz"

DESIGN: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "places_m": ("f", (None, 2)),
    "weights": ("f", (None, 2)),
    "path_loss": ("f", (None, 2)),
    "owner": ("iu", (None,)),
    "cuts": ("f", (None, 4)),
}
STEPPED: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "step_levels": ("iu", ()),
    "step_limit_m": ("f", ()),
}
"""Arrays that results of version 1.0 do not have."""

KINDS: dict[type[Any], dict[str, tuple[str, tuple[int | None, ...]]]] = {
    Potential: {
        "nodes_m": ("f", (None, 2)),
        "corners": ("iu", (None, 3)),
        "at_nodes": ("f", (None,)),
        "at_sides": ("f", (None,)),
        **STEPPED,
    },
    Tilts: {
        **DESIGN,
        "of_steps": ("f", (None, None, 2)),
        "levels": ("iu", ()),
        "value": ("f", ()),
        "alone_levels": ("iu", ()),
        "alone_value": ("f", ()),
    },
}
"""NumPy kinds and shapes of the arrays of each kind of certificate."""


def bound_arrays(plans: Sequence[Plan]) -> Arrays:
    """Return the arrays to save for the certificates that prove the plans' bounds."""
    return {
        f"{number}_{name}": np.asarray(getattr(plan.bound.certificate, name))
        for number, plan in enumerate(plans)
        if plan.bound is not None and plan.bound.certificate is not None
        for name in KINDS[type(plan.bound.certificate)]
    }


def read_certificates(path: Path, count: int) -> tuple[Potential | Tilts | None, ...]:
    """Return the saved certificate of each of `count` robots; None for robots without one."""
    if not path.is_file():
        return (None,) * count
    arrays = read_npz(path)
    return tuple(_certificate(path, arrays, number) for number in range(count))


def _certificate(path: Path, arrays: Arrays, number: int) -> Potential | Tilts | None:
    for made, kinds in KINDS.items():
        if not any(f"{number}_{name}" in arrays for name in kinds):
            continue
        found: dict[str, Any] = {}
        for name, (kind, sizes) in kinds.items():
            key = f"{number}_{name}"
            # Earlier files have only bounds without the other robots.
            if key not in arrays:
                key = f"{number}_{name.removeprefix('alone_')}"
            if key not in arrays and name in {**DESIGN, **STEPPED}:
                continue
            if key not in arrays:
                raise InputError("the array is missing", file=path, key=key, remedy=REMEDY)
            _require_fit(
                path, key, arrays[key], kind if arrays[key].size or name in DESIGN else "", sizes
            )
            found[name] = arrays[key].astype(np.float64 if kind == "f" else np.intp)
        for name, array in found.items():
            found[name] = array if array.ndim else array.item()
        return made(**found)
    return None
