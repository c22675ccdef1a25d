"""Conversion of tables to TOML text with comments."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any, cast

Tables = Mapping[str, Any]


def toml_text(tables: Tables, comments: Mapping[str, str] | None = None) -> str:
    """Return tables as TOML."""
    # Values are texts, booleans, finite numbers, arrays of these, tables, and arrays of tables. A
    # key without a value (None) is left out. Comments are given by dotted key and stand at the end
    # of its line, or above the header of its table.
    return "\n".join(_table((), tables, comments or {})).strip("\n") + "\n"


def _table(path: tuple[str, ...], table: Tables, comments: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines of a table: first its values, then its tables."""
    tables: list[tuple[str, Any]] = []
    for key, value in table.items():
        if value is None:
            continue
        if isinstance(value, Mapping) or _is_array_of_tables(value):
            tables.append((key, cast("Any", value)))
            continue
        comment = comments.get(".".join((*path, key)))
        yield f"{_key(key)} = {_value(value)}" + (f"  # {comment}" if comment else "")
    for key, value in tables:
        own = (*path, key)
        name = ".".join(_key(part) for part in own)
        several = not isinstance(value, Mapping)
        for entry in cast("list[Tables]", list(value) if several else [value]):
            yield ""
            if comment := comments.get(".".join(own)):
                yield f"# {comment}"
            yield f"[[{name}]]" if several else f"[{name}]"
            yield from _table(own, entry, comments)


def _is_array_of_tables(value: object) -> bool:
    if not isinstance(value, list | tuple):
        return False
    entries = cast("list[object]", value)
    return bool(entries) and all(isinstance(entry, Mapping) for entry in entries)


def _key(key: str) -> str:
    bare = key.replace("-", "").replace("_", "")
    return key if bare.isalnum() and bare.isascii() else _text(key)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{value} is not a finite number")
        return repr(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(entry) for entry in cast('list[object]', value))}]"
    raise TypeError(f"a {type(value).__name__} has no form in TOML")


def _text(text: str) -> str:
    # JSON escapes all characters that TOML forbids in a basic string, except for DEL.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
