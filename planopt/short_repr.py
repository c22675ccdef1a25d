"""Short text representations of objects with arrays, for ``print`` and interactive prompts."""

import textwrap
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

WIDTH, LINES = 100, 5  # Maximum width in characters and maximum number of lines
MOST_SHOWN = 4  # Maximum number of array or tuple entries that are shown individually
MOST_NESTED = 200  # Maximum length of nested data in characters; longer data are shown by type name


def short_repr(self: object) -> str:
    """Return the fields of a dataclass as text, at most `LINES` lines of `WIDTH` characters."""
    return wrapped(_fields_of(self))


def wrapped(text: str, lines: int = LINES) -> str:
    """Return `text` on at most `lines` lines; excess text becomes ``...``."""
    return "\n".join(
        textwrap.wrap(
            text,
            WIDTH,
            subsequent_indent="    ",
            max_lines=lines,
            placeholder=" ...",
            break_on_hyphens=False,
        )
    )


def _fields_of(thing: object) -> str:
    shown = (
        f"{part.name}={_short(getattr(thing, part.name))}"
        for part in fields(cast("Any", thing))
        if part.repr and not part.name.startswith("_")
    )
    return f"{type(thing).__name__}({', '.join(shown)})"


def _short(value: Any) -> str:
    """Return a short text representation of one value."""
    if isinstance(value, np.ndarray):
        return _short_array(cast("NDArray[Any]", value))
    if isinstance(value, Enum):
        return repr(value.value)
    if isinstance(value, float):
        return f"{value:.6g}"
    if is_dataclass(value):
        text = _fields_of(value)
        return text if len(text) <= MOST_NESTED else f"{type(value).__name__}(...)"
    if isinstance(value, Mapping):
        entries = cast("Mapping[Any, Any]", value).items()
        return "{" + ", ".join(f"{key!r}: {_short(entry)}" for key, entry in entries) + "}"
    if isinstance(value, tuple | list):
        members = tuple(cast("Any", value))
        if len(members) > MOST_SHOWN:
            return f"<{len(members)} x {type(members[0]).__name__}>"
        return "(" + ", ".join(_short(member) for member in members) + ")"
    return repr(value)


def _short_array(values: NDArray[Any]) -> str:
    if values.ndim == 1 and 0 < values.size <= MOST_SHOWN:
        return "[" + ", ".join(_short(value.item()) for value in values) + "]"
    if values.dtype == np.bool_:
        return f"<{values.shape}, {np.count_nonzero(values)} true>"
    if values.size == 0 or values.dtype.kind not in "iuf":
        return f"<{values.shape}>"
    number = values[np.isfinite(values)]
    if number.size == 0:
        return f"<{values.shape}, none finite>"
    return f"<{values.shape}, {number.min():.4g} to {number.max():.4g}>"


def shown_number(value: float | None, unit: str = "", digits: int = 4) -> str:
    """Return a number with its unit as text, 0 for rounding errors; a dash for None."""
    return "-" if value is None else f"{0.0 if abs(value) < 1e-15 else value:.{digits}g}{unit}"
