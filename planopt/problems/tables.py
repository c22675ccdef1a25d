"""Parts of a problem: frozen dataclasses whose annotations declare the keys of a table.

Type, range and meaning of a key are declared once, at the field of the dataclass and in the
docstring below it. The table of a problem file, its JSON schema, the documentation and messages
follow from the declaration. Making a part in
Python validates it against the same table, so that it cannot differ from one read from a file.

Numbers are finite, integers are no booleans, text is no number, and an unknown key is an error.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any, ClassVar, Literal, TypeVar, cast, get_type_hints

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    Strict,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
)
from pydantic import create_model as model_of
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from planopt.errors import InputError
from planopt.plain_values import make_plain
from planopt.problems.messages import input_error
from planopt.world.workspace import LARGEST_COORDINATE_M

Metres = Annotated[float, Field(ge=-LARGEST_COORDINATE_M, le=LARGEST_COORDINATE_M)]
Decibels = Annotated[float, Field(ge=-500, le=500)]

# TOML and JSON have arrays only, so the tuple itself is not strict; the numbers in it are.
Pair = Annotated[tuple[Metres, Metres], Strict(False)]
Quad = Annotated[tuple[Metres, Metres, Metres, Metres], Strict(False)]

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=100)]
# No operating system accepts a NUL in a file name; Python raises a ValueError for it.
FileName = Annotated[str, Field(pattern=r"^[^\x00]+$")]


SMALLEST = 1e-6
"""Least length, time, speed and rate in SI units where zero makes no sense: a micrometre."""


def _meanings(data: type[Any]) -> dict[str, str]:
    """Return the docstrings below the fields of a part or table, from its source."""
    return {
        field.target.id: " ".join(text.value.value.split())
        for found in _tree_of(data.__module__).body
        if isinstance(found, ast.ClassDef) and found.name == data.__name__
        for field, text in pairwise(found.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }


@lru_cache(maxsize=16)
def _tree_of(module: str) -> ast.Module:
    try:
        return ast.parse(inspect.getsource(sys.modules[module]))
    except (KeyError, OSError, TypeError):  # there is no module or no source file
        return ast.Module([], [])


class Table(BaseModel):
    """A table of a problem file: frozen, strict, finite, without unknown keys."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)

    def __init_subclass__(cls, **_: Any) -> None:
        # pydantic's own option reads the source of each class by itself, which takes longer.
        for name, said in _meanings(cls).items():
            hint = cls.__annotations__[name]
            cls.__annotations__[name] = Annotated[hint, Field(description=said)]


class FileKey:
    """Marks a key that names a file, relative to the folder in the context of the validation."""

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Read text or a path, and return a path."""
        return core_schema.with_info_wrap_validator_function(
            _read_path, handler.generate_schema(FileName)
        )


def _read_path(value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Path:
    return _folder(info) / handler(str(value) if isinstance(value, Path) else value)


def _folder(info: ValidationInfo) -> Path:
    """Return the folder that relative file names start at."""
    context = cast("Mapping[str, Path] | None", info.context)
    return Path() if context is None else context["folder"]


FilePath = Annotated[Path, FileKey()]


class ValidatedAs:
    """Marks a key that is validated as another type than its annotation says."""

    def __init__(self, kind: Any) -> None:
        self._kind = kind

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return the schema of that type."""
        return handler.generate_schema(self._kind)


Of = TypeVar("Of", bound="Part")


class Documented(type):
    """The class of parts: their documentation lists their fields."""

    @property
    def __doc__(cls) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The docstring with a section of the fields and their meanings."""
        text = inspect.cleandoc(cls.__dict__.get("__doc__") or "")
        words, _, examples = text.partition("\n\nExamples\n")
        rows = [
            f"{name}\n{fill(said, 96, initial_indent='    ', subsequent_indent='    ')}"
            for name, said in _meanings(cls).items()
        ]
        section = "\n".join(["Attributes", "----------", *rows])
        return f"{words}\n\n{section}" + (f"\n\nExamples\n{examples}" if examples else "")


@dataclass(frozen=True)
class Part(metaclass=Documented):
    """A part of a problem. Values are validated, and become plain Python values."""

    at: ClassVar[str] = ""  # Key of its table, for messages
    Keys: ClassVar[type[BaseModel]] = Table  # Keys of the file that are no fields
    not_keys: ClassVar[frozenset[str]] = frozenset()  # Fields that are no keys of the file

    def __post_init__(self) -> None:
        make_plain(self)
        model = table_of(type(self))
        try:
            table = model.model_validate(self.to_keys())
        except ValidationError as error:
            raise input_error(error, model, table=self.at) from None
        for name, value in self.of_keys(table).items():
            if name not in self.not_keys:
                object.__setattr__(self, name, value)
        fault = self.fault()
        if fault is not None:
            message, _, remedy = fault.partition(": ")
            raise InputError(message, key=self.at, remedy=remedy)

    def to_keys(self) -> dict[str, Any]:
        """Return the keys and values of its table."""
        return _kind_of(self) | {
            each.name: getattr(self, each.name)
            for each in fields(self)
            if each.name not in self.not_keys
        }

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return the values of its fields that a validated table has; subclasses add the others."""
        names = (each.name for each in fields(cls) if each.name not in cls.not_keys)
        return {name: getattr(table, name) for name in names}

    def fault(self) -> str | None:
        """Return which values do not go together and, after a colon, the remedy; or None."""
        return None

    @classmethod
    def of_table(cls: type[Of], table: Any) -> Of:
        """Return the part that a validated table describes."""
        made = object.__new__(cls)
        for name, value in cls.of_keys(table).items():
            object.__setattr__(made, name, value)
        fault = made.fault()
        if fault is not None:
            raise fault_of(fault)
        return made

    @classmethod
    def tables(cls) -> Sequence[type[BaseModel]]:
        """Return its table, for messages."""
        return (table_of(cls),)

    @classmethod
    def __get_pydantic_core_schema__(
        cls, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Accept a part, or read its table."""
        return ReadAs(table_of(cls), cls.of_table, cls).__get_pydantic_core_schema__(
            source, handler
        )


class ReadAs:
    """Marks a key whose value is an object, or the table that describes one.

    Parameters
    ----------
    table
        The table.
    make
        From a validated table to the object, with the folder of the file if `needs_folder`.
    kinds
        Classes of the object.
    to_keys
        From an object made in Python to its table, which is validated; None where the object
        validates itself.
    """

    def __init__(
        self,
        table: type[BaseModel],
        make: Callable[..., Any],
        *kinds: type[Any],
        to_keys: Callable[[Any], dict[str, Any]] | None = None,
        needs_folder: bool = False,
    ) -> None:
        self._table, self._make, self._kinds = table, make, kinds
        self._to_keys, self._needs_folder = to_keys, needs_folder

    def tables(self) -> Sequence[type[BaseModel]]:
        """Return the table."""
        return (self._table,)

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Accept an object, or read its table."""
        return core_schema.with_info_wrap_validator_function(
            self._read, handler.generate_schema(self._table)
        )

    def _read(
        self, value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo
    ) -> Any:
        if isinstance(value, self._kinds):
            if self._to_keys is not None:
                handler(self._to_keys(value))
            return value
        table = handler(value)
        return self._make(table, _folder(info)) if self._needs_folder else self._make(table)


def fault_of(words: str) -> PydanticCustomError:
    """Return the error of a table whose keys do not go together: the fault, a colon, a remedy."""
    return PydanticCustomError("one_of", "{words}", {"words": words})


@lru_cache(maxsize=128)
def table_of(data: type[Any]) -> type[BaseModel]:
    """Return the table whose keys are the fields of a dataclass."""
    hints = get_type_hints(data, include_extras=True)
    words = inspect.cleandoc(data.__dict__.get("__doc__") or "").partition("\n")[0]
    keys: dict[str, Any] = {}
    for key, kind in _kind_of(data).items():
        keys[key] = (Literal[kind], Field(description=getattr(data, "summary", words)))  # pyright: ignore
    base, not_keys = getattr(data, "Keys", Table), getattr(data, "not_keys", ())
    meanings = _meanings(data) if issubclass(data, Part) else {}
    for each in fields(data):
        if each.name not in not_keys:
            hint = hints[each.name]
            if each.name in meanings:
                hint = Annotated[hint, Field(description=meanings[each.name])]
            keys[each.name] = hint if each.default is MISSING else (hint, each.default)
    name = data.__name__.removesuffix("Term").removesuffix("Settings") + "Table"
    made = model_of(name, __base__=base, __doc__=words, __module__=data.__module__, **keys)
    return cast("type[BaseModel]", made)


def _kind_of(data: Any) -> dict[str, Any]:
    """Return the key that selects a table among others, if it has one."""
    return {"kind": data.kind} if isinstance(getattr(data, "kind", None), str) else {}


def made_of(data: type[Any], table: BaseModel) -> Any:
    """Return the dataclass that a table describes."""
    return data(**{each.name: getattr(table, each.name) for each in fields(data)})


def saved(value: Any) -> Any:
    """Return a value as JSON has it: parts as tables, without keys that have no value."""
    if isinstance(value, Part):
        value = {key: one for key, one in value.to_keys().items() if one != ()}
    if isinstance(value, Mapping):
        table = cast("Mapping[str, Any]", value)
        return {key: saved(one) for key, one in table.items() if one is not None}
    if isinstance(value, tuple):
        return [saved(one) for one in cast("tuple[Any, ...]", value)]
    return str(value.absolute()) if isinstance(value, Path) else value
