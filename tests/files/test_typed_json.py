"""Plain data as JSON and back: equal, or an error."""

import json
import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
import pytest
from numpy.typing import NDArray

from planopt.files.tables import decoded, encoded


class Colour(StrEnum):
    """Two of them."""

    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Inner:
    """A part."""

    share: float
    names: tuple[str, ...]


@dataclass(frozen=True)
class Outer:
    """Every kind of part."""

    count: int
    flag: bool
    colour: Colour
    colours: tuple[Colour, ...]
    pair: tuple[int, str]
    parts: list[Inner]
    by_name: dict[str, float]
    powers: NDArray[np.float64]
    table: NDArray[np.int64]
    flags: NDArray[np.bool_]
    may_miss: str | None
    none: None = None
    inner: Inner | None = None
    more: dict[str, float] = field(default_factory=dict)


SAMPLE = Outer(
    3,
    True,
    Colour.BLUE,
    (Colour.RED, Colour.BLUE),
    (1, "a"),
    [Inner(2.0, ()), Inner(-0.1, ("x", "y"))],
    {"a": math.nan, "b": 1e-300},
    np.array([1.0, math.nan, 0.1 + 0.2]),
    np.arange(6).reshape(2, 3),
    np.array([], dtype=np.bool_),
    None,
    inner=Inner(1.0, ("z",)),
)


def test_what_is_read_is_what_was_written() -> None:
    """To the last bit, through strict JSON text; types included."""
    text = json.dumps(encoded(SAMPLE), allow_nan=False)
    again = decoded(Outer, json.loads(text))
    assert repr(again) == repr(SAMPLE)
    for name in ("powers", "table", "flags"):
        np.testing.assert_array_equal(getattr(again, name), getattr(SAMPLE, name))
        assert getattr(again, name).dtype == getattr(SAMPLE, name).dtype
    assert isinstance(again.colour, Colour) and isinstance(again.colours, tuple)
    assert math.isnan(again.by_name["a"]) and again.parts == SAMPLE.parts


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("count", 1.5),
        ("count", True),
        ("count", "3"),
        ("flag", 1),
        ("colour", "green"),
        ("colours", "red"),
        ("pair", [1]),
        ("parts", [{"share": 1.0}]),
        ("parts", [{"share": 1.0, "names": [], "extra": 0}]),
        ("by_name", {"a": "many"}),
        ("by_name", []),
        ("powers", [1.0, True]),
        ("powers", [[1.0], [1.0, 2.0]]),
        ("table", [1.5]),
        ("flags", [0]),
        ("may_miss", 3),
        ("none", 0),
        ("inner", []),
    ],
)
def test_other_types_are_refused(name: str, value: object) -> None:
    """Whatever a damaged file has in place of one part."""
    with pytest.raises(ValueError):
        decoded(Outer, {**encoded(SAMPLE), name: value})


def test_missing_and_unknown_parts() -> None:
    """A file of another version of the type."""
    data = encoded(SAMPLE)
    with pytest.raises(ValueError, match="missing or unknown keys"):
        decoded(Outer, {**data, "extra": 1})
    del data["count"]
    with pytest.raises(ValueError, match="missing or unknown keys"):
        decoded(Outer, data)


def test_what_json_has_no_form_for() -> None:
    with pytest.raises(TypeError, match="set"):
        encoded({"a": {1, 2}})
