"""Values that users give to frozen data: made plain, checked, and of the type that is asked for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError


def require_weights(weight: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """`weight` as ``(count,)`` floats from 0 on, or an InputError."""
    found = np.asarray(weight, dtype=np.float64)
    if found.shape != (count,) or not (np.isfinite(found).all() and (found >= 0.0).all()):
        raise InputError(
            f"{count} places need as many weights from 0 on, not {found.shape}", key="weight"
        )
    return found


Part = TypeVar("Part")


def plain(value: Any) -> Any:
    """Return `value` with tuples in place of lists and arrays, and Python's numbers in them.

    Examples
    --------
    >>> import numpy as np
    >>> plain([np.float64(1.0), np.array([2, 3])])
    (1.0, (2, 3))
    """
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
        value = plain(getattr(data, part.name))
        if part.name in files and isinstance(value, str):
            value = Path(value)
        object.__setattr__(data, part.name, value)


def part_of(key: str, value: object, kind: type[Part], remedy: str | None = None) -> Part:
    """Return `value`, which must be of a kind.

    Raises
    ------
    InputError
        It is of another; `key` and `remedy` say where, and what to do.
    """
    if not isinstance(value, kind):
        words = f"give a {kind.__name__}" if remedy is None else remedy
        raise InputError(f"is a {type(value).__name__}", key=key, remedy=words)
    return value


def parts_of(
    key: str, values: object, kind: type[Part], remedy: str | None = None
) -> tuple[Part, ...]:
    """Return one value or several, which must be of a kind, as a tuple; as :func:`part_of`."""
    if isinstance(values, kind):
        return (values,)
    if not isinstance(values, Iterable):
        return (part_of(key, values, kind, remedy),)
    return tuple(
        part_of(f"{key}[{number}]", value, kind, remedy)
        for number, value in enumerate(cast("Iterable[object]", values))
    )
