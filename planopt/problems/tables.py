"""What the tables of a problem file have in common: strictness and the kinds of values.

Numbers are finite, integers are no booleans, text is no number, and a key that is not known is
an error: a problem file with a slip in it must not plan something else.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, Strict

from planopt.world.footprints import LARGEST_COORDINATE_M

Metres = Annotated[float, Field(ge=-LARGEST_COORDINATE_M, le=LARGEST_COORDINATE_M)]
Decibels = Annotated[float, Field(ge=-500, le=500)]

# TOML and JSON have arrays only, so the tuple itself is not strict; the numbers in it are.
Pair = Annotated[tuple[Metres, Metres], Strict(False)]
Quad = Annotated[tuple[Metres, Metres, Metres, Metres], Strict(False)]

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=100)]
# No operating system takes a NUL in a file name; Python raises a ValueError for it.
FileName = Annotated[str, Field(pattern=r"^[^\x00]+$")]


SMALLEST = 1e-6
"""Least length, time, speed and rate in SI units where zero makes no sense: a micrometre."""


class Table(BaseModel):
    """A table of a problem file: frozen, strict, finite, without unknown keys."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)
