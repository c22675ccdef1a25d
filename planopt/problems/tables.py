"""The common rules of a problem file's tables, and tables that describe frozen dataclasses.

Numbers are finite, integers are no booleans, text is no number, and a key that is not known is
an error: a problem file with a slip in it must not plan something else.

If a table describes a dataclass, types, ranges and meanings stand in the annotations of the
dataclass, and its defaults are those of the table: file and Python share one definition.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import MISSING, fields
from functools import lru_cache
from typing import Annotated, Any, TypeVar, cast, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, Strict
from pydantic import create_model as model_of
from pydantic_core import CoreSchema, core_schema

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


Data = TypeVar("Data")


class TableOf:
    """Marks a place of the schema where a table describes a dataclass."""

    def __init__(self, data: type[Any], name: str) -> None:
        self._data, self._name = data, name

    def tables(self) -> Sequence[type[BaseModel]]:
        """Return the table."""
        return (table_of(self._data, self._name),)

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Read a table, and make the dataclass of it."""
        (table,) = self.tables()
        return core_schema.no_info_after_validator_function(
            lambda read: made_of(self._data, read), handler.generate_schema(table)
        )


@lru_cache(maxsize=64)
def table_of(data: type[Any], name: str, kind: Any = None, summary: str = "") -> type[BaseModel]:
    """Return the table whose keys are the fields of a dataclass."""
    hints = get_type_hints(data, include_extras=True)
    keys: dict[str, Any] = {}
    if kind is not None:
        keys["kind"] = (kind, Field(description=summary))
    for each in fields(data):
        hint = hints[each.name]
        keys[each.name] = hint if each.default is MISSING else (hint, each.default)
    words = inspect.cleandoc(data.__doc__ or summary).partition("\n")[0]
    made = model_of(name, __base__=Table, __doc__=words, __module__=data.__module__, **keys)
    return cast("type[BaseModel]", made)


def made_of(data: type[Data], table: BaseModel) -> Data:
    """Return the dataclass that a table describes."""
    names = [each.name for each in fields(cast("Any", data))]
    return data(**{name: getattr(table, name) for name in names})
