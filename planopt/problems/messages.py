"""Validation errors in the words of the problem file.

pydantic reports every fault with the path of its own model tree. A user gets one: the key as it
is written in the file, the value that stands there, what is allowed, and the nearest known key
if the key itself is wrong.
"""

from __future__ import annotations

import contextlib
import difflib
import math
import re
import reprlib
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any, Protocol, cast, get_args, runtime_checkable

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from planopt.errors import InputError

LIKE_WORDS = 0.9
"""Keys of words so alike, in whatever order, are taken for each other."""

LONGEST_KEY = 100
"""Keys and names are compared with known ones up to this length."""

KeyPath = tuple[str | int, ...]


@runtime_checkable
class OpenTables(Protocol):
    """Alternatives of a table that are known only when a file is read."""

    def tables(self) -> Sequence[type[BaseModel]]:
        """Return their models."""
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
    """One clear error for a failed validation."""
    faults = error.errors(include_url=False)
    fault = min(faults, key=lambda item: item["type"] != "extra_forbidden")
    path, fields, field = _resolve(fault["loc"], model)
    remedy = None if field is None else field.description
    match fault["type"]:
        case "extra_forbidden":
            message = "is not a known key"
            remedy = nearest(str(path[-1]), list(fields))
        case "missing" if isinstance(path[-1], int):
            # A short array: pydantic calls its absent numbers missing.
            path = path[:-1]
            message = f"is {shown(fault['input'])}, should have more numbers"
        case "missing":
            message = "is missing"
        case "union_tag_not_found" | "union_tag_invalid":
            path = (*path, "kind")
            message = _kind_message(fault)
        case "too_long" | "too_short":
            count, words = len(fault["input"]), _allowed(fault, field)
            message = f"has {count} entries, {words.partition(', not ')[0]}"
        case "one_of" | "task":
            # Of several keys: what stands there is no single value. What to do follows a colon,
            # unless it is given by itself.
            message, given = fault["msg"], fault.get("ctx", {}).get("remedy")
            if given is None:
                message, _, given = message.partition(": ")
            remedy = given or remedy
        case _:
            message = f"is {shown(fault['input'])}, {_allowed(fault, field)}"
    if fault["type"] in _RANGE_TYPES and field is not None:
        remedy = _within(fault, field)
    prefix: KeyPath = () if table is None else (table,)
    return InputError(message, file=file, key=key_text(prefix + path), remedy=remedy)


@contextlib.contextmanager
def located(model: type[BaseModel], file: Path | None, table: str | None = None) -> Generator[None]:
    """Turn validation errors of tables of `model` into errors that name the key and the file."""
    try:
        yield
    except ValidationError as error:
        raise input_error(error, model, file=file, table=table) from None
    except InputError as error:
        if file is None:
            raise
        raise error.located(file) from error.__cause__


def key_text(path: KeyPath) -> str | None:
    """``robots[0].start_m`` for ``("robots", 0, "start_m")``; None for the empty path."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".") or None


def shown(value: object) -> str:
    """`value` as short as a message needs it."""
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
    except ValueError:  # Python refuses to print integers of thousands of digits
        return "a huge number"


def nearest(word: str, known: Sequence[str]) -> str:
    """Return what to write instead of the unknown `word`."""
    # The comparison takes time that grows with the square of the length.
    word = word[:LONGEST_KEY]
    # max_speed_m_s is speed_max_m_s with its words in another order.
    by_words = {_sorted_words(key): key for key in known}
    same = difflib.get_close_matches(_sorted_words(word), list(by_words), n=1, cutoff=LIKE_WORDS)
    close = [by_words[key] for key in same] or difflib.get_close_matches(word, known, n=1)
    return f"did you mean {close[0]}?" if close else f"known: {', '.join(sorted(known))}"


def _sorted_words(key: str) -> str:
    return "_".join(sorted(key.lower().split("_")))


def _kind_message(fault: ErrorDetails) -> str:
    """A table whose ``kind`` selects none of its alternatives."""
    context = fault.get("ctx", {})
    if "tag" not in context:
        return "is missing"
    return f"is {shown(context['tag'])}, should be one of {context['expected_tags']}"


def _allowed(fault: ErrorDetails, field: FieldInfo | None) -> str:
    """Return what is allowed instead of the value."""
    kind = fault["type"]
    bounds = _range(field) if kind in _RANGE_TYPES and field is not None else ""
    wording = re.sub(r"^\w+ should", "should", fault["msg"]).split(" after validation")[0]
    return bounds or _ALLOWED.get(kind, wording)


def _range(field: FieldInfo) -> str:
    """Return both ends of the range of `field`."""
    words = {"gt": "more than", "ge": "at least", "lt": "less than", "le": "at most"}
    parts = [
        f"{word} {getattr(bound, name):g}"
        for bound in field.metadata
        for name, word in words.items()
        if hasattr(bound, name)
    ]
    return f"should be {' and '.join(parts)}" if parts else ""


_BEYOND = {"gt": "above", "ge": "of at least", "lt": "below", "le": "of at most"}
_LIMITS = {"greater_than": "gt", "greater_than_equal": "ge", "less_than": "lt"}
"""Limits by pydantic's kinds of faults; ``le`` by the last."""


def _within(fault: ErrorDetails, field: FieldInfo) -> str:
    """Return what to give in place of a number beyond its range, with an example."""
    bounds = {
        name: float(getattr(bound, name))
        for bound in field.metadata
        for name in _BEYOND
        if hasattr(bound, name)
    }
    limit = _LIMITS.get(fault["type"], "le")
    # Limits of the numbers in an array are not those of the key.
    bounds.setdefault(limit, float(fault.get("ctx", {})[limit]))
    low = bounds.get("gt", bounds.get("ge", -math.inf))
    high = bounds.get("lt", bounds.get("le", math.inf))
    default: object = field.default
    usual = [float(default)] if isinstance(default, int | float) else []
    examples = (value for value in (*usual, 1.0, 0.5, 10.0, low, high) if low < value < high)
    example = next(examples, bounds[limit])
    words = f"give a value {_BEYOND[limit]} {bounds[limit]:g}, e.g. {example:g}"
    return words if field.description is None else f"{words}: {field.description}"


def _resolve(
    location: KeyPath, model: type[BaseModel]
) -> tuple[KeyPath, dict[str, FieldInfo], FieldInfo | None]:
    """Follow pydantic's path into the models."""
    path: list[str | int] = []
    fields: dict[str, FieldInfo] = {}
    field: FieldInfo | None = None
    tables: list[type[BaseModel]] = [model]
    for part in location:
        if len(tables) > 1 and isinstance(part, str):
            tables = [table for table in tables if part in _kinds(table)]
        else:
            path.append(part)
            if isinstance(part, str):
                # Keys of an open table are told of where the table is.
                fields = _fields(tables[0]) if tables else {}
                field = fields.get(part) if tables else field
                hints = () if field is None else (field.annotation, *field.metadata)
                found = [table for hint in hints for table in _tables(hint)]
                tables = list(dict.fromkeys(found))
    return tuple(path), fields, field


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Fields of `model` by the key that the file uses."""
    return {info.alias or name: info for name, info in model.model_fields.items()}


def _kinds(model: type[BaseModel]) -> tuple[object, ...]:
    """Values of ``kind`` that select `model` among alternatives."""
    info = model.model_fields.get("kind")
    return () if info is None else get_args(info.annotation)


def _tables(annotation: Any) -> list[type[BaseModel]]:
    """Every table that `annotation` mentions, those of an open set at the time of asking."""
    if isinstance(annotation, OpenTables):
        return list(annotation.tables())
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for inner in get_args(annotation) for table in _tables(inner)]
