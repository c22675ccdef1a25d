"""Base class of JSON objects of results, whose keys are declared once with type and source."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from planopt.arrays import Floats
from planopt.files.tables import LARGEST, REMEDY
from planopt.files.typed_json import encoded
from planopt.keys import input_error


@dataclass(frozen=True)
class Source:
    """Function that computes the value of a key from the object to be saved."""

    value: Callable[[Any], object]


OMITTED = object()
"""Value of a key that is left out of the JSON object."""

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0)]
Place = Annotated[list[Number], Field(min_length=2, max_length=2)]
Computed = Annotated[Any, Field(default=None)]


class Record(BaseModel):
    """JSON object of a result, or part of one."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, frozen=True)

    @classmethod
    def written(cls, source: object, **values: object) -> dict[str, Any]:
        """Return the JSON data of an object; `values` take precedence over its attributes."""
        found: dict[str, Any] = {}
        for name, declared in cls.model_fields.items():
            if name not in values:
                own = next((each for each in declared.metadata if isinstance(each, Source)), None)
                values[name] = getattr(source, name) if own is None else own.value(source)
            if values[name] is not OMITTED:
                found[name] = encoded(values[name])
        return found

    @classmethod
    def read(cls, data: Mapping[str, Any], file: Path) -> Self:
        """Return the record in a file's JSON data, after validation."""
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise input_error(error, cls, file=file).remedied(REMEDY) from None


class Places(Record):
    """JSON object of positions along a path."""

    x_m: list[Number] = Field(default=[], max_length=10**6)
    y_m: list[Number] = Field(default=[], max_length=10**6)

    @model_validator(mode="after")
    def _have_both_coordinates(self) -> Self:
        if len(self.x_m) != len(self.y_m):
            raise PydanticCustomError("one_of", "x_m and y_m differ in length")
        return self

    @property
    def positions_m(self) -> Floats:
        """Return the positions (n, 2)."""
        return np.stack([self.x_m, self.y_m], axis=1).reshape(-1, 2)


def xy(positions_m: Floats) -> dict[str, Floats]:
    """Return positions (n, 2) as JSON data with separate keys for x and y."""
    return {"x_m": positions_m[:, 0], "y_m": positions_m[:, 1]}
