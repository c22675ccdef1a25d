"""Comparison of a saved document with the same document recomputed."""

import hashlib
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast


class Tolerance(NamedTuple):
    """Maximum difference of two numbers that count as equal."""

    absolute: float
    relative: float


EXACT = Tolerance(1e-6, 1e-9)  # Computed from saved numbers; the default
PREDICTION = Tolerance(1e-3, 1e-9)  # dB or probability: large logs are predicted in groups
FIT = Tolerance(1e-6, 1e-3)  # Iterative fit
SITE = Tolerance(1e-5, 1e-5)  # Iteration with a tolerance of 1e-7

TOLERANCES = {
    **dict.fromkeys(
        (
            *("achieved", "anmse_db", "best_margin_db", "connectivity", "deviation_db"),
            *("log_det_m", "mean_squared_error_db2", "min_connectivity", "path_loss_variance_db2"),
            *("predicted_connectivity", "predicted_db", "predicted_min_connectivity"),
            *("relaxation_db", "rms_db", "rms_without_multipath_db", "slack_db", "trace_m_db"),
        ),
        PREDICTION,
    ),
    **dict.fromkeys(("parameters", "standard_errors", "theta", "theta_covariance"), FIT),
    **dict.fromkeys(("precision", "precision_mean"), SITE),
}
"""Tolerances of keys and columns that differ from the default `EXACT`."""

BOUNDED = TOLERANCES | {"bound": Tolerance(0.0, 1e-9), "gap": Tolerance(1e-10, 1e-9)}
"""Tolerances of results with their own bounds, up to rounding on another processor."""
REPEATED = TOLERANCES | {"bound": Tolerance(0.0, 1e-6)}
"""Tolerances of results whose bounds are proven anew by an iteration, not from a certificate."""
ACCEPTED = frozenset(
    ("bound_wall_s", "iterations", "rung", "solve_s", "step_s", "termination", "wall_s")
)
"""Keys of wall times, iteration counts, fallbacks and solver states, which are not recomputed."""
TAKEN = frozenset(
    (
        *("aim", "blocked", "crossings", "drive", "explanation", "kkt_residual"),
        *("lattice_objective", "pivot", "route", "seed", "x_m", "y_m"),
    )
)
"""Keys of planning results that a replay takes as input; the digest covers their values."""

DIGEST = "digest"

SHOWN_ALIKE = 3  # Maximum number of reported differences whose keys differ only in an index

_NUMBER = re.compile(r"(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)")
_INDEX = re.compile(r"\[\d+\]")


@dataclass(frozen=True)
class Difference:
    """A saved value that differs from the recomputed one."""

    key: str  # For example robots[0].x_m[3]
    saved: str  # As printed
    found: str


def differences(
    saved: object,
    found: object,
    key: str = "",
    name: str = "",
    accepted: frozenset[str] = ACCEPTED,
    tolerances: Mapping[str, Tolerance] = TOLERANCES,
) -> Iterator[Difference]:
    """Yield every different leaf, and every key missing from one of the two documents."""
    if name in accepted:
        return
    if isinstance(saved, Mapping) and isinstance(found, Mapping):
        table, other = cast("Mapping[str, object]", saved), cast("Mapping[str, object]", found)
        for part in dict.fromkeys([*other, *table]):
            where = f"{key}.{part}".removeprefix(".")
            if part not in table:
                yield Difference(where, "is missing", _shown(other[part]))
            elif part not in other:
                yield Difference(where, _shown(table[part]), "no such key")
            else:
                yield from differences(table[part], other[part], where, part, accepted, tolerances)
    elif isinstance(saved, list) and isinstance(found, list):
        these, those = cast("list[object]", saved), cast("list[object]", found)
        if len(these) != len(those):
            yield Difference(key, _shown(these), _shown(those))
            return
        for index, (one, other_one) in enumerate(zip(these, those, strict=True)):
            where = f"{key}[{index}]"
            yield from differences(one, other_one, where, name, accepted, tolerances)
    elif not same(cast("object", saved), found, tolerances.get(name, EXACT)):
        value = cast("object", saved)
        one, other = _shown(value), _shown(found)
        yield Difference(key, repr(value) if one == other else one, other)


def in_words(file: str, found: Iterable[Difference], source: str = "recomputed") -> list[str]:
    """Return a line per difference, but only a few for differences in the same column."""
    by_kind: dict[str, list[Difference]] = {}
    for one in found:
        by_kind.setdefault(_INDEX.sub("[]", one.key), []).append(one)
    words: list[str] = []
    for kind, alike in by_kind.items():
        words += [f"{file}, {_at(file, d.key)}: {d.saved}, {source} {d.found}" for d in alike[:3]]
        if len(alike) > SHOWN_ALIKE:
            words.append(f"{file}, key {kind}: {len(alike) - SHOWN_ALIKE} more like these")
    return words


def _at(file: str, key: str) -> str:
    """Return the location of a difference as text; row 1 of a CSV table is the header."""
    column, _, index = key.rstrip("]").rpartition("[")
    if file.endswith(".csv") and index.isdecimal():
        return f"row {int(index) + 2}, key {column}"
    return f"key {key}"


def digest(data: Mapping[str, object]) -> str:
    """Return a digest of the values of all keys in `TAKEN` outside the problem's tables."""
    taken = list(_taken({key: part for key, part in data.items() if key != "problem_file"}))
    return digest_of(json.dumps(taken))


def digest_of(text: str) -> str:
    """Return the digest of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _taken(data: object) -> Iterator[tuple[str, object]]:
    if isinstance(data, Mapping):
        for name, part in sorted(cast("Mapping[str, object]", data).items()):
            if name in TAKEN:
                yield name, part
            else:
                yield from _taken(part)
    elif isinstance(data, Sequence) and not isinstance(data, str):
        for part in cast("Sequence[object]", data):
            yield from _taken(part)


def same_words(saved: str, found: str) -> bool:
    """Return True if two texts agree up to rounding of the last digit of decimal numbers."""
    these, those = _NUMBER.split(saved), _NUMBER.split(found)
    # The separators of the split, at odd indices, are the numbers.
    return len(these) == len(those) and all(
        one == other or (index % 2 == 1 and _same_shown(one, other))
        for index, (one, other) in enumerate(zip(these, those, strict=True))
    )


def _same_shown(saved: str, found: str) -> bool:
    """Return True if two printed numbers agree up to rounding of the last digit."""
    if "e" in saved + found:
        return math.isclose(float(saved), float(found), rel_tol=0.1)
    digits = max(len(number.partition(".")[2]) for number in (saved, found))
    return digits > 0 and abs(float(saved) - float(found)) < 1.5 * 10.0**-digits


def same(saved: object, found: object, tolerance: Tolerance) -> bool:
    """Return True if two values agree within a tolerance."""
    if isinstance(saved, bool) or isinstance(found, bool):
        return saved is found
    if isinstance(saved, (int, float)) and isinstance(found, (int, float)):
        if saved == found:
            return True
        try:
            one, other = float(saved), float(found)
        except OverflowError:  # An integer with hundreds of digits
            return False
        absolute, relative = tolerance
        both_none = math.isnan(one) and math.isnan(other)
        return both_none or math.isclose(one, other, rel_tol=relative, abs_tol=absolute)
    if isinstance(saved, str) and isinstance(found, str):
        # Labels must match exactly; numbers in sentences are rounded.
        return saved == found or (" " in saved and same_words(saved, found))
    return saved is None and found is None


def _shown(value: object) -> str:
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return f"{len(cast('list[object]', value))} values"
    if isinstance(value, float):
        return "empty" if math.isnan(value) else f"{value:.9g}"
    return json.dumps(value, ensure_ascii=False, default=str)
