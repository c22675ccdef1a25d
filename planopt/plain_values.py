"""Conversion and validation of user values for frozen dataclasses."""

from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError


def require_weights(weight: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return `weight` as non-negative floats (count,), or raise an InputError."""
    found = np.asarray(weight, dtype=np.float64)
    if found.shape != (count,) or not (np.isfinite(found).all() and (found >= 0.0).all()):
        raise InputError(
            f"has shape {found.shape}, should be {count} weights of at least 0",
            key="weight",
            remedy="give one weight for each position, or leave it out",
        )
    return found


def plain(value: Any) -> Any:
    """Return `value` with lists and arrays converted to tuples of Python numbers."""
    if isinstance(value, np.ndarray | np.generic):
        value = cast("Any", value).tolist()
    if isinstance(value, list | tuple):
        return tuple(plain(entry) for entry in cast("tuple[Any, ...]", value))
    return value


def make_plain(data: Any, *files: str) -> None:
    """Convert the fields of a frozen dataclass to plain values, or to paths if in `files`."""
    for part in fields(data):
        if not part.init:
            continue
        value = plain(getattr(data, part.name))
        if part.name in files and isinstance(value, str):
            value = Path(value)
        object.__setattr__(data, part.name, value)
