"""Typed conversion to and from JSON: dataclasses, arrays, enumerations, tuples and numbers.

JSON has neither NaN nor infinity: both are written as null, which is read as NaN.
"""

import math
import types
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError

Value = TypeVar("Value")

NOT_FINITE = ("nan", "inf", "-inf")
"""Non-finite numbers as written by earlier versions."""


def encoded(value: object) -> Any:
    """Return a value as JSON data; dataclasses become tables of their fields."""
    match value:
        case Enum():
            return value.value
        case None | bool() | int() | str():
            return value
        case float():
            return finite(value)
        case np.ndarray() | np.generic():
            return encoded(cast("NDArray[Any]", value).tolist())
        case list() | tuple():
            return [encoded(part) for part in cast("Sequence[object]", value)]
        case Mapping():
            table = cast("Mapping[str, object]", value)
            return {name: encoded(part) for name, part in table.items()}
        case _ if is_dataclass(value) and not isinstance(value, type):
            return {part.name: encoded(getattr(value, part.name)) for part in fields(value)}
        case _:
            raise TypeError(f"{type(value).__name__} cannot be written as JSON")


def finite(value: float | None) -> float | None:
    """Return a number, or None if it is missing or not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def decoded(kind: type[Value], data: object) -> Value:
    """Return the value of type `kind` from JSON data; inverse of :func:`encoded`."""
    return cast("Value", _decoded(kind, data))


def _decoded(kind: Any, data: Any) -> Any:
    origin = get_origin(kind)
    if kind is Any:
        return data
    if kind is None or kind is type(None):
        return _of_type(data, type(None))
    if origin in (Union, types.UnionType):
        return _first_that_fits(get_args(kind), data)
    if origin is np.ndarray:
        dtype = np.dtype(get_args(get_args(kind)[1])[0])
        return np.array(_numbers(dtype, data), dtype=dtype)
    if origin is tuple:
        parts = _of_type(data, list)
        inner = get_args(kind)
        if inner[1:] == (...,):
            return tuple(_decoded(inner[0], part) for part in parts)
        if len(inner) != len(parts):
            raise ValueError(f"{len(parts)} entries where {len(inner)} should be")
        return tuple(_decoded(one, part) for one, part in zip(inner, parts, strict=True))
    if origin is list:
        return [_decoded(get_args(kind)[0], part) for part in _of_type(data, list)]
    if origin is not None and issubclass(origin, Mapping):
        table = _of_type(data, dict)
        return {str(name): _decoded(get_args(kind)[1], part) for name, part in table.items()}
    if is_dataclass(kind):
        return _dataclass(cast("type[Any]", kind), _of_type(data, dict))
    if issubclass(kind, Enum):
        return kind(data)
    if kind is float:
        return _float(data)
    return _of_type(data, kind)


def _dataclass(kind: type[Any], table: Mapping[str, Any]) -> Any:
    hints = get_type_hints(kind)
    names = [part.name for part in fields(kind) if part.init]
    if set(names) != set(table):
        wrong = ", ".join(sorted(set(names) ^ set(table))[:5])
        raise ValueError(f"an entry has missing or unknown keys: {wrong}")
    return kind(**{name: _decoded(hints[name], table[name]) for name in names})


def _first_that_fits(kinds: Sequence[Any], data: Any) -> Any:
    if data is None and type(None) in kinds:
        return None
    for kind in kinds:
        try:
            return _decoded(kind, data)
        except ValueError:
            continue
    raise ValueError(f"{type(data).__name__} is none of {kinds}")


def _numbers(dtype: np.dtype[Any], data: Any) -> Any:
    """Return nested lists of JSON data with all values checked against an array's `dtype`."""
    if isinstance(data, list):
        return [_numbers(dtype, part) for part in cast("list[Any]", data)]
    if dtype.kind == "f":
        return _float(data)
    return _of_type(data, bool if dtype.kind == "b" else int)


def _float(data: Any) -> float:
    if data is None:
        return math.nan
    if isinstance(data, str) and data in NOT_FINITE:
        return float(data)
    if isinstance(data, bool) or not isinstance(data, int | float):
        raise ValueError(f"{data!r} is no number")
    return float(data)


def _of_type(data: Any, kind: type[Any]) -> Any:
    # In Python bool is a subclass of int; here it is not accepted as one.
    if type(data) is not kind:
        raise ValueError(f"{type(data).__name__} where {kind.__name__} should be")
    return data


def whole_number(file: Path, data: Mapping[str, object], key: str) -> int:
    """Return the value at `key` of a saved JSON object, which must be an integer."""
    value = cast("object", data.get(key))
    if not isinstance(value, int) or isinstance(value, bool):
        raise InputError(
            "is missing, or is not a whole number",
            file=file,
            key=key,
            remedy="save the result again",
        )
    return value
