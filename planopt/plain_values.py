"""Values that users give to frozen data: made plain, and checked."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError


def require_weights(weight: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """`weight` as ``(count,)`` floats from 0 on, or an InputError."""
    found = np.asarray(weight, dtype=np.float64)
    if found.shape != (count,) or not (np.isfinite(found).all() and (found >= 0.0).all()):
        raise InputError(
            f"{count} places need as many weights from 0 on, not {found.shape}",
            key="weight",
            remedy="give one weight for each place, or none",
        )
    return found


def plain(value: Any) -> Any:
    """Return `value` with tuples in place of lists and arrays, and Python's numbers in them."""
    if isinstance(value, np.ndarray | np.generic):
        value = cast("Any", value).tolist()
    if isinstance(value, list | tuple):
        return tuple(plain(entry) for entry in cast("tuple[Any, ...]", value))
    return value


def make_plain(data: Any, *files: str) -> None:
    """Make the values of a frozen dataclass plain, while it is being made.

    Those of the fields `files` may be text, and become paths.
    """
    for part in fields(data):
        if not part.init:
            continue
        value = plain(getattr(data, part.name))
        if part.name in files and isinstance(value, str):
            value = Path(value)
        object.__setattr__(data, part.name, value)
