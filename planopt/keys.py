"""Parts and tables of problem files: dataclasses whose annotations declare the keys.

Type, range and meaning of a key are declared once, at the field of the dataclass and in the
docstring below it. The table of a problem file, its JSON schema, the documentation and the error
messages are derived from this declaration. Numbers must be finite, booleans are not integers, text
is not a number, and an unknown key is an error.
"""

import ast
import contextlib
import difflib
import inspect
import math
import re
import reprlib
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from textwrap import fill
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    Protocol,
    TypeVar,
    cast,
    get_args,
    get_type_hints,
    runtime_checkable,
)

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    Strict,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
)
from pydantic import create_model as model_of
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError, core_schema

from planopt.errors import InputError
from planopt.files.reading import PRIVATE, data_folder
from planopt.parts import make_plain

LIKE_WORDS = 0.9
"""Minimum similarity, ignoring word order, at which a known key is suggested for an unknown one."""
LONGEST_KEY = 100  # Maximum length of a word that is compared with known keys and names

KeyPath = tuple[str | int, ...]


@runtime_checkable
class OpenTables(Protocol):
    """Protocol of alternative tables for one key that are registered at run time."""

    def tables(self) -> Sequence[type[BaseModel]]:
        """Return the pydantic models of the alternative tables."""
        ...


_ALLOWED = {
    "bool_type": "should be true or false",
    "float_type": "should be a number",
    "int_type": "should be a whole number",
    "list_type": "should be an array",
    "model_type": "should be a table",
    "string_type": "should be text",
    "tuple_type": "should be an array",
}
_RANGE_TYPES = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}


def input_error(
    error: ValidationError,
    model: type[BaseModel],
    *,
    file: Path | str | None = None,
    table: str | None = None,
) -> InputError:
    """Return one InputError for a failed validation; an unknown key is reported first."""
    faults = error.errors(include_url=False)
    fault = min(faults, key=lambda item: item["type"] != "extra_forbidden")
    path, fields, field = _resolve(fault["loc"], model)
    remedy = None if field is None else _meaning(field)
    match fault["type"]:
        case "extra_forbidden":
            message = "is not a known key"
            remedy = nearest(str(path[-1]), list(fields))
        case "missing" if isinstance(path[-1], int):
            # pydantic reports the absent numbers of a short array as missing, each once.
            path, array = path[:-1], fault["loc"][:-1]
            count = 1 + max(int(each["loc"][-1]) for each in faults if each["loc"][:-1] == array)
            message = f"is {shown(fault['input'])}, should have {count} numbers"
        case "missing":
            message = "is missing"
            if field is not None and _tables(field.annotation):
                remedy = f"add the table [{key_text(path)}]"
        case "union_tag_not_found" | "union_tag_invalid":
            # The table's kind matches no alternative.
            path, context = (*path, "kind"), fault.get("ctx", {})
            message = (
                f"is {shown(context['tag'])}, should be one of {context['expected_tags']}"
                if "tag" in context
                else "is missing"
            )
        case "list_type" | "tuple_type" if isinstance(fault["input"], dict):
            message = "is a single table, should be an array of tables"
            remedy = f"write [[{key_text(path)}]] instead of [{key_text(path)}]"
        case "too_long" | "too_short":
            count, words = len(fault["input"]), _allowed(fault, field)
            message = f"has {count} entries, {words.partition(', not ')[0]}"
            message = message.replace("items", "entries").replace("item", "entry")
        case "one_of":
            message, _, given = fault["msg"].partition(": ")
            remedy = given or remedy
        case _:
            message = f"is {shown(fault['input'])}, {_allowed(fault, field)}"
    if fault["type"] in _RANGE_TYPES and field is not None:
        remedy = _within(fault, field)
    prefix: KeyPath = () if table is None else (table,)
    return InputError(message, file=file, key=key_text(prefix + path), remedy=remedy)


@contextlib.contextmanager
def located(model: type[BaseModel], file: Path | None, table: str | None = None) -> Generator[None]:
    """Convert validation errors of `model` into InputErrors that name the key and the file."""
    try:
        yield
    except ValidationError as error:
        raise input_error(error, model, file=file, table=table) from None
    except InputError as error:
        if file is None:
            raise
        raise error.located(file) from error.__cause__


def key_text(path: KeyPath) -> str | None:
    """Return a key path as text, such as ``robots[0].start_m``; None for the empty path."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".") or None


def shown(value: object) -> str:
    """Return `value` as it appears in a message."""
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        entries = cast("list[object]", value)
        if any(isinstance(entry, (dict, list)) for entry in entries):
            return f"an array of {len(entries)} entries"
        return reprlib.repr(entries)
    if isinstance(value, bool):
        return str(value).lower()
    try:
        return reprlib.repr(value)
    except ValueError:  # Python refuses to print integers with thousands of digits
        return "an integer that is too large"


def nearest(word: str, known: Sequence[str]) -> str:
    """Return a suggestion for the unknown `word`: the closest known name, or all of them."""
    # The run time of the comparison is quadratic in the length.
    word = word[:LONGEST_KEY]
    # max_speed_m_s and speed_max_m_s differ only in word order.
    by_words = {_sorted_words(key): key for key in known}
    same = difflib.get_close_matches(_sorted_words(word), list(by_words), n=1, cutoff=LIKE_WORDS)
    close = [by_words[key] for key in same] or difflib.get_close_matches(word, known, n=1)
    return f"did you mean {close[0]}?" if close else f"known: {', '.join(sorted(known))}"


def _sorted_words(key: str) -> str:
    return "_".join(sorted(key.lower().split("_")))


def _allowed(fault: ErrorDetails, field: FieldInfo | None) -> str:
    """Return text on the values that a faulty key allows."""
    kind = fault["type"]
    if kind in _RANGE_TYPES and field is not None and (bounds := _bounds_of(field)):
        words = {"gt": "more than", "ge": "at least", "lt": "less than", "le": "at most"}
        if set(bounds) == {"ge", "le"}:
            return f"should be from {bounds['ge']:g} to {bounds['le']:g}"
        return f"should be {' and '.join(f'{words[name]} {bounds[name]:g}' for name in bounds)}"
    wording = re.sub(r"^\w+ should", "should", fault["msg"]).split(" after validation")[0]
    if kind == "string_pattern_mismatch" and _NAME in wording:
        return "should have only letters, digits, _ and -"
    return _ALLOWED.get(kind, wording)


def _bounds_of(field: FieldInfo) -> dict[str, float]:
    """Return the lower and upper limits of a key by pydantic's names, such as ``ge``."""
    return {
        name: float(getattr(bound, name))
        for bound in field.metadata
        for name in ("gt", "ge", "lt", "le")
        if hasattr(bound, name)
    }


_NAME = r"^[A-Za-z0-9_-]+$"  # Pattern of names
_LIMITS = {"greater_than": "gt", "greater_than_equal": "ge", "less_than": "lt"}
"""Names of limits by pydantic's error type; other types are ``le``."""


def _within(fault: ErrorDetails, field: FieldInfo) -> str:
    """Return text for a number out of range: a valid example, and the key's meaning."""
    bounds = _bounds_of(field)
    limit = _LIMITS.get(fault["type"], "le")
    # Elements of an array have their own limits.
    bounds.setdefault(limit, float(fault.get("ctx", {})[limit]))
    low = bounds.get("gt", bounds.get("ge", -math.inf))
    high = bounds.get("lt", bounds.get("le", math.inf))
    default: object = field.default
    usual = [float(default)] if isinstance(default, int | float) else []
    examples = (*usual, 1.0, 0.5, 10.0, low, high) if low >= 0.0 else usual
    example = next((f"e.g. {value:g}" for value in examples if low < value < high), None)
    return "; ".join(words for words in (example, _meaning(field)) if words)


def _meaning(field: FieldInfo) -> str | None:
    """Return the meaning of a key for a message; None for a key without description."""
    return field.description and f"meaning: {field.description.rstrip('.')}"


def _resolve(
    location: KeyPath, model: type[BaseModel]
) -> tuple[KeyPath, dict[str, FieldInfo], FieldInfo | None]:
    """Return an error location's key path, all fields of the table with the key, and the field."""
    path: list[str | int] = []
    fields: dict[str, FieldInfo] = {}
    field: FieldInfo | None = None
    tables: list[type[BaseModel]] = [model]
    for part in location:
        if isinstance(part, str) and part.startswith("tuple["):
            continue  # pydantic names the alternative of a union of tuples
        if len(tables) > 1 and isinstance(part, str):
            tables = [table for table in tables if part in _kinds(table)]
        else:
            path.append(part)
            if isinstance(part, str):
                # A fault in a key of an open table is reported at the table.
                fields = _fields(tables[0]) if tables else {}
                field = fields.get(part) if tables else field
                hints = () if field is None else (field.annotation, *field.metadata)
                found = [table for hint in hints for table in _tables(hint)]
                tables = list(dict.fromkeys(found))
    return tuple(path), fields, field


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of `model` by their key in the file."""
    return {info.alias or name: info for name, info in model.model_fields.items()}


def _kinds(model: type[BaseModel]) -> tuple[object, ...]:
    """Return the values of ``kind`` that select `model` among alternatives."""
    info = model.model_fields.get("kind")
    return () if info is None else get_args(info.annotation)


def _tables(annotation: Any) -> list[type[BaseModel]]:
    """Return all table classes in an annotation, including registered ones."""
    if isinstance(annotation, OpenTables):
        return list(annotation.tables())
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for inner in get_args(annotation) for table in _tables(inner)]


LARGEST_COORDINATE_M = 1e9
"""Largest coordinate accepted, in metres; larger values are no positions on Earth."""
SMALLEST = 1e-6  # Minimum of lengths, times, speeds and rates that must be positive, in SI units

# pydantic ignores a field's bound if its annotation already has one, hence a type for lengths.
Metres = Annotated[float, Field(ge=-LARGEST_COORDINATE_M, le=LARGEST_COORDINATE_M)]
Distance = Annotated[float, Field(ge=0, le=LARGEST_COORDINATE_M)]
Length = Annotated[float, Field(ge=SMALLEST, le=LARGEST_COORDINATE_M)]
Decibels = Annotated[float, Field(ge=-500, le=500)]

# TOML and JSON have only arrays, so the tuple is not strict, but its numbers are.
Pair = Annotated[tuple[Metres, Metres], Strict(False)]
# Origin of a frame: latitude, longitude and, if it is not 0, the angle from east to the x axis.
Latitude = Annotated[float, Field(gt=-90, lt=90)]
Longitude = Annotated[float, Field(ge=-180, le=180)]
Angle = Annotated[float, Field(ge=-360, le=360)]
OriginKey = (
    Annotated[tuple[Latitude, Longitude], Strict(False)]
    | Annotated[tuple[Latitude, Longitude, Angle], Strict(False)]
    | None
)
Quad = Annotated[tuple[Metres, Metres, Metres, Metres], Strict(False)]

Name = Annotated[str, Field(pattern=_NAME, max_length=100)]
# No operating system accepts NUL in a file name, and Python raises a ValueError for it.
FileName = Annotated[str, Field(pattern=r"^[^\x00]+$")]


def _meanings(data: type[Any]) -> dict[str, str]:
    """Return the docstrings below the fields of a part or table, read from its source."""
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
    except (KeyError, OSError, TypeError):  # No module or no source file
        return ast.Module([], [])


class Table(BaseModel):
    """A table of a problem file: frozen and strict, with finite numbers and no unknown keys."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)

    def __init_subclass__(cls, **_: Any) -> None:
        # pydantic's own option parses the source once per class, which is slower.
        for name, said in _meanings(cls).items():
            hint = cls.__annotations__[name]
            cls.__annotations__[name] = Annotated[hint, Field(description=said)]


def folder_of(info: ValidationInfo) -> Path:
    """Return the folder against which relative file names are resolved."""
    context = cast("Mapping[str, Path] | None", info.context)
    return Path() if context is None else context["folder"]


class ValidatedAs:
    """Marker for a key that is validated as a type other than its annotation."""

    def __init__(self, kind: Any) -> None:
        self._kind = kind

    def tables(self) -> Sequence[type[BaseModel]]:
        """Return the models of the tables in the type."""
        return _tables(self._kind)

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return pydantic's schema of the type that validates the key."""
        return handler.generate_schema(self._kind)


def _text_of(value: object) -> object:
    return str(value) if isinstance(value, Path) else value


def _in_folder(name: str, info: ValidationInfo) -> Path:
    if not name.startswith(PRIVATE):
        return folder_of(info) / name
    folder = data_folder()
    return Path(name) if folder is None else folder / name.removeprefix(PRIVATE)


FilePath = Annotated[
    Path, ValidatedAs(FileName), BeforeValidator(_text_of), AfterValidator(_in_folder)
]
"""A file as text or path, relative to the folder in the validation context."""

Of = TypeVar("Of", bound="Part")


class Documented(type):
    """Metaclass of parts that appends their fields to the class docstring."""

    @property
    def __doc__(cls) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Return the class docstring with a section on the fields and their meanings."""
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
    """A part of a problem, with values validated and converted to plain Python values."""

    at: ClassVar[str] = ""  # Key of its table, for messages
    Keys: ClassVar[type[BaseModel]] = Table  # Keys of the file that are not fields
    not_keys: ClassVar[frozenset[str]] = frozenset()  # Fields that are not keys of the file

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
        """Return the keys and values of the part's table."""
        return _kind_of(self) | {
            each.name: getattr(self, each.name)
            for each in fields(self)
            if each.name not in self.not_keys
        }

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return the field values in a validated table, for subclasses to complete."""
        names = (each.name for each in fields(cls) if each.name not in cls.not_keys)
        return {name: getattr(table, name) for name in names}

    def fault(self) -> str | None:
        """Return a conflict between the part's values as "fault: remedy"; None if there is none."""
        return None

    @classmethod
    def of_table(cls: type[Of], table: Any) -> Of:
        """Create the part from a validated table."""
        made = object.__new__(cls)
        for name, value in cls.of_keys(table).items():
            object.__setattr__(made, name, value)
        fault = made.fault()
        if fault is not None:
            raise fault_of(fault)
        return made

    @classmethod
    def tables(cls) -> Sequence[type[BaseModel]]:
        """Return the model of the part's table, for messages."""
        return (table_of(cls),)

    @classmethod
    def __get_pydantic_core_schema__(
        cls, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return a schema that accepts the part itself or its table."""
        return ReadAs(table_of(cls), cls.of_table, cls).__get_pydantic_core_schema__(
            source, handler
        )


class ReadAs:
    """Marker for a key whose value is an object of certain types, or a table describing one."""

    def __init__(
        self,
        table: type[BaseModel],
        make: Callable[[Any], Any],  # From a validated table
        *kinds: type[Any],
        # From a Python object to its table for validation; None if the object validates itself
        to_keys: Callable[[Any], dict[str, Any]] | None = None,
    ) -> None:
        self._table, self._make, self._kinds, self._to_keys = table, make, kinds, to_keys

    def tables(self) -> Sequence[type[BaseModel]]:
        """Return the model of the table that describes the object."""
        return (self._table,)

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return a schema that accepts the object itself or its table."""
        return core_schema.no_info_wrap_validator_function(
            self._read,
            handler.generate_schema(self._table),
            serialization=core_schema.plain_serializer_function_ser_schema(saved),
        )

    def _read(self, value: object, handler: ValidatorFunctionWrapHandler) -> Any:
        if isinstance(value, self._kinds):
            if self._to_keys is not None:
                handler(self._to_keys(value))
            return value
        return self._make(handler(value))


def fault_of(words: str) -> PydanticCustomError:
    """Return the error for keys of a table that conflict; `words` are "fault: remedy"."""
    return PydanticCustomError("one_of", "{words}", {"words": words})


@lru_cache(maxsize=128)
def table_of(data: type[Any]) -> type[BaseModel]:
    """Return the table model whose keys are the fields of a dataclass."""
    hints = get_type_hints(data, include_extras=True)
    words = inspect.cleandoc(data.__dict__.get("__doc__") or "").partition("\n")[0]
    keys: dict[str, Any] = {}
    for key, kind in _kind_of(data).items():
        keys[key] = (Literal[kind], Field(description=getattr(data, "summary", words)))
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
    """Return the key that selects a table among alternatives, if it has one."""
    return {"kind": data.kind} if isinstance(getattr(data, "kind", None), str) else {}


def made_of(data: type[Any], table: BaseModel) -> Any:
    """Return the dataclass instance described by a table."""
    left_out = getattr(data, "not_keys", ())
    names = (each.name for each in fields(data) if each.name not in left_out)
    return data(**{name: getattr(table, name) for name in names})


def saved(value: Any) -> Any:
    """Return a value as JSON data; parts become tables without their unset keys."""
    if isinstance(value, Part):
        value = {key: one for key, one in value.to_keys().items() if one != ()}
    if isinstance(value, Mapping):
        table = cast("Mapping[str, Any]", value)
        return {key: saved(one) for key, one in table.items() if one is not None}
    if isinstance(value, tuple):
        return [saved(one) for one in cast("tuple[Any, ...]", value)]
    return str(value.absolute()) if isinstance(value, Path) else value
