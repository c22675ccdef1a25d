"""Disagreements of a file's data with the same data computed again."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, cast

from planopt.planning.loop.metrics import ANY, POSSIBLE

EXACT = 1e-6
"""Numbers that are computed again from what the files say (m, s) agree to this."""

PREDICTION = 1e-3
"""Predictions computed again (dB, probability) agree to this: another machine rounds otherwise, and
beyond the exact limit a run keeps groups of neighbours from step to step."""

FIT = 1e-3
"""Fitted parameters agree to this share of themselves: they come from an iteration."""

PREDICTED_NAMES = frozenset(
    (
        "achieved",
        "anmse_db",
        "best_margin_db",
        "connectivity",
        "deviation_db",
        "predicted_connectivity",
        "log_det_m",
        "mean_squared_error_db2",
        "min_connectivity",
        "predicted_db",
        "predicted_min_connectivity",
        "relaxation_db",
        "rms_db",
        "rms_without_multipath_db",
        "path_loss_variance_db2",
        "slack_db",
        "trace_m_db",
    )
)
FITTED_NAMES = frozenset(("parameters", "standard_errors", "theta", "theta_covariance"))

RANGES = {
    **POSSIBLE,
    "connectivity": (0.0, 1.0),
    "deviation_db": (0.0, math.inf),
    "min_connectivity": (0.0, 1.0),
    "verified_rate": (0.0, 1.0),
}
"""Least and largest value that a number can have: however near to what was found, no probability
and no share is beyond 1."""

SHOWN_ALIKE = 3
"""Of disagreements that differ in nothing but an index, so many are reported one by one."""

_NUMBER = re.compile(r"(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)")
_INDEX = re.compile(r"\[\d+\]")


@dataclass(frozen=True)
class Disagreement:
    """One value that is not as found."""

    key: str  # Where it stands, as robots[0].x_m[3]
    said: str  # The two, as people read them
    found: str


def disagreements(
    said: object, found: object, key: str = "", name: str = ""
) -> Iterator[Disagreement]:
    """Every leaf of `said` that is not as in `found`, keys that only one of them has included."""
    if isinstance(said, Mapping) and isinstance(found, Mapping):
        table, other = cast("Mapping[str, object]", said), cast("Mapping[str, object]", found)
        for part in dict.fromkeys([*other, *table]):
            where = f"{key}.{part}".removeprefix(".")
            if part not in table:
                yield Disagreement(where, "is missing", _shown(other[part]))
            elif part not in other:
                yield Disagreement(where, _shown(table[part]), "no such key")
            else:
                yield from disagreements(table[part], other[part], where, part)
    elif isinstance(said, list) and isinstance(found, list):
        these, those = cast("list[object]", said), cast("list[object]", found)
        if len(these) != len(those):
            yield Disagreement(key, _shown(these), _shown(those))
            return
        for index, (one, other_one) in enumerate(zip(these, those, strict=True)):
            yield from disagreements(one, other_one, f"{key}[{index}]", name)
    elif not _same(cast("object", said), found, name):
        value = cast("object", said)
        one, other = _shown(value), _shown(found)
        yield Disagreement(key, repr(value) if one == other else one, other)


def without_searched(data: Mapping[str, Any]) -> dict[str, Any]:
    """A result without ways that a bound forbade: the search found them, which is not repeated."""
    return {key: value for key, value in data.items() if key != "blocked"}


def in_words(file: str, differences: Iterator[Disagreement], source: str = "found") -> list[str]:
    """Differences with their file, few of those that differ in nothing but an index."""
    by_kind: dict[str, list[Disagreement]] = {}
    for difference in differences:
        by_kind.setdefault(_INDEX.sub("[]", difference.key), []).append(difference)
    words: list[str] = []
    for kind, alike in by_kind.items():
        words += [f"{file}, key {d.key}: {d.said}, {source} {d.found}" for d in alike[:SHOWN_ALIKE]]
        if len(alike) > SHOWN_ALIKE:
            words.append(f"{file}, key {kind}: {len(alike) - SHOWN_ALIKE} more like these")
    return words


def same_words(said: str, found: str) -> bool:
    """Return whether two texts are one but for the last shown digit of decimal numbers in them."""
    these, those = _NUMBER.split(said), _NUMBER.split(found)
    # What is split at is a number at every odd place.
    return len(these) == len(those) and all(
        one == other or (place % 2 == 1 and _same_shown(one, other))
        for place, (one, other) in enumerate(zip(these, those, strict=True))
    )


def _same_shown(said: str, found: str) -> bool:
    """Return whether two printed numbers differ by no more than rounding the last digit."""
    if "e" in said + found:
        return math.isclose(float(said), float(found), rel_tol=0.1)
    digits = max(len(number.partition(".")[2]) for number in (said, found))
    return digits > 0 and abs(float(said) - float(found)) < 1.5 * 10.0**-digits


def _same(said: object, found: object, name: str) -> bool:
    if isinstance(said, bool) or isinstance(found, bool):
        return said is found
    if isinstance(said, (int, float)) and isinstance(found, (int, float)):
        absolute = PREDICTION if name in PREDICTED_NAMES else EXACT
        relative = FIT if name in FITTED_NAMES else 1e-9
        if said == found:
            return True
        try:
            one, other = float(said), float(found)
        except OverflowError:  # a whole number of hundreds of digits
            return False
        least, largest = RANGES.get(name, ANY)
        if not least <= one <= largest and least <= other <= largest:
            return False
        both_none = math.isnan(one) and math.isnan(other)
        return both_none or math.isclose(one, other, rel_tol=relative, abs_tol=absolute)
    if isinstance(said, str) and isinstance(found, str):
        # Labels and numbers as text stand as they are; sentences have numbers that were rounded.
        return said == found or (" " in said and same_words(said, found))
    return said is None and found is None


def _shown(value: object) -> str:
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return f"{len(cast('list[object]', value))} values"
    if isinstance(value, float):
        return "empty" if math.isnan(value) else f"{value:.9g}"
    return json.dumps(value, ensure_ascii=False, default=str)
