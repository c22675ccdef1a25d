"""Typed parts of saved JSON objects. Strict JSON has no NaN and no infinity: null stands for both.

A record types the values that a replay starts from; all others are computed again and compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from planopt.files.tables import LARGEST

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0)]
Place = Annotated[list[Number], Field(min_length=2, max_length=2)]


class Record(BaseModel):
    """Part of a saved JSON object."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, frozen=True)


def finite(value: float | None) -> float | None:
    """Return `value`, or None where it is missing or not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def finite_list(values: Iterable[float]) -> list[float | None]:
    """Return every number of `values` by :func:`finite`."""
    return [finite(value) for value in values]


def plain(value: object) -> Any:
    """Return a value as JSON data; dataclasses become tables of their fields."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray):
        return plain(cast("NDArray[Any]", value).tolist())
    if isinstance(value, float):
        return finite(float(value))
    if isinstance(value, list | tuple):
        return [plain(part) for part in cast("Iterable[object]", value)]
    if is_dataclass(value) and not isinstance(value, type):
        return {part.name: plain(getattr(value, part.name)) for part in fields(value)}
    return value
