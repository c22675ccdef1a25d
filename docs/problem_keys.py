"""The keys of problem files as Markdown tables, from the schema they are validated against."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from planopt.problems.schema import json_schema

Node = dict[str, Any]

BOUNDS = (
    ("exclusiveMinimum", "> {}"),
    ("minimum", ">= {}"),
    ("exclusiveMaximum", "< {}"),
    ("maximum", "<= {}"),
)


def problem_keys() -> str:
    """Every table and key of a problem file."""
    schema = json_schema()
    parts: list[str] = []
    for name, node in schema["properties"].items():
        is_list = node.get("type") == "array"
        heading = f"[[{name}]]" if is_list else f"[{name}]"
        (target,) = _tables_of(node, schema)
        parts += _table(heading, name, target, schema)
    return "\n".join(parts)


def write_problem_keys(path: Path) -> None:
    """Write :func:`problem_keys` to a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(problem_keys(), encoding="utf-8")


def _table(heading: str, prefix: str, table: Node, schema: Node) -> list[str]:
    """A table of the file, and the tables in it."""
    lines = [f"## `{heading}`", "", table.get("description", "").replace("``", "`"), ""]
    rows, inner = [], []
    for key, node in table["properties"].items():
        path = f"{prefix}.{key}"
        targets = _tables_of(node, schema)
        if not targets:
            rows.append(
                f"| `{key}` | {_kind(node)} | {_default(key, node, table)} | {_text(node)} |"
            )
        for target in targets:
            listed = node.get("type") == "array"
            inner += _table(f"[[{path}]]" if listed else f"[{path}]", path, target, schema)
    if rows:
        lines += ["| key | kind | default | meaning |", "|---|---|---|---|", *rows, ""]
    return lines + inner


def _definition(schema: Node, node: Node) -> Node:
    return schema["$defs"][node["$ref"].rsplit("/", 1)[1]]


def _tables_of(node: Node, schema: Node) -> list[Node]:
    """The tables that a key may hold; none for a plain value."""
    choices = [node, *node.get("anyOf", []), node.get("items", {})]
    choices += [inner for choice in choices for inner in choice.get("oneOf", [])]
    return [_definition(schema, choice) for choice in choices if "$ref" in choice]


def _kind(node: Node) -> str:
    """Type and range in words."""
    choices = [c for c in node.get("anyOf", [node]) if c.get("type") != "null"]
    words = []
    for choice in choices:
        if "const" in choice:
            words.append(f"`{_toml(choice['const'])}`")
        elif "enum" in choice:
            words.append(" or ".join(f"`{_toml(value)}`" for value in choice["enum"]))
        elif choice.get("type") == "array" and "prefixItems" in choice:
            words.append(f"{len(choice['prefixItems'])} numbers")
        else:
            limits = [form.format(f"{choice[key]:g}") for key, form in BOUNDS if key in choice]
            words.append(", ".join([choice.get("type", "value"), *limits]))
    return " or ".join(words)


def _default(key: str, node: Node, table: Node) -> str:
    if key in table.get("required", []):
        return "required"
    return "left out" if node.get("default") is None else f"`{_toml(node['default'])}`"


def _toml(value: object) -> str:
    """A value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)


def _text(node: Node) -> str:
    return node.get("description", "").replace("|", "\\|")
