"""Parts of saved files: numbers, and the base of typed records.

Strict JSON has no NaN and no infinity: a number that does not exist is null.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

LARGEST = 1e9
"""Positions, times, powers and parameters beyond this in a saved file are a fault."""

REMEDY = "save the plan or run again"
"""What to do about a saved file that cannot be read."""

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0)]


class Record(BaseModel):
    """Part of a saved JSON object: what judging starts from. The rest is computed again."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, frozen=True)


def finite(value: float | None) -> float | None:
    """`value`, or None where it is missing or not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def finite_list(values: Iterable[float]) -> list[float | None]:
    """Every number of `values` by :func:`finite`."""
    return [finite(value) for value in values]
