"""Whatever stands in a problem file, loading gives a problem or one of our errors."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from planopt.errors import InputError
from planopt.problems import problem_from_dict, problem_to_dict
from planopt.problems.library import library_folder
from planopt.problems.load import load
from planopt.problems.problem import Problem

Build = Callable[[object], Problem]

OPEN_FIELD = (library_folder() / "open_field.toml").read_text(encoding="utf-8")

SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.sampled_from([10**400, -(2**64)])
    | st.floats()
    | st.sampled_from([0.0, -1.0, 1e308, 5e-324, 1e9])
    | st.text(max_size=8)
    | st.sampled_from(["raster", "model", "POLYGON EMPTY", "a.wkt", "\0", "\ud800", "../x.json"])
)
KEYS = st.text(max_size=6) | st.sampled_from(["name", "file", "count", "holes", "kind", "wkt"])
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4),
    max_leaves=10,
)


def places(value: object, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Path of every value in nested tables."""
    if isinstance(value, dict):
        items: list[tuple[Any, Any]] = list(value.items())
    elif isinstance(value, list):
        items = list(enumerate(value))
    else:
        items = []
    return [path, *(place for key, inner in items for place in places(inner, (*path, key)))][
        0 if path else 1 :
    ]


@settings(
    max_examples=400,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data())
def test_mutated_tables_give_a_problem_or_our_error(
    data: st.DataObject, tables: dict[str, Any], built: Build
) -> None:
    """Values replaced, keys renamed, added or deleted: no error of a dependency gets through."""
    mutated = copy.deepcopy(tables)
    for _ in range(data.draw(st.integers(1, 3))):
        *parents, last = data.draw(st.sampled_from(places(mutated)))
        table: Any = mutated
        for part in parents:
            table = table[part]
        action = data.draw(st.sampled_from(["replace", "delete", "rename", "add"]))
        if action == "replace":
            table[last] = data.draw(VALUES)
        elif action == "delete" or isinstance(table, list):
            del table[last]
        elif action == "rename":
            table[data.draw(KEYS)] = table.pop(last)
        else:
            table[data.draw(KEYS)] = data.draw(VALUES)
        if not places(mutated):
            break
    try:
        problem = built(mutated)
    except InputError as error:
        assert str(error)
        return
    # What is accepted can be saved and comes back the same.
    text = json.dumps(problem_to_dict(problem), allow_nan=False)
    assert problem_from_dict(json.loads(text), file=problem.file) == problem


@settings(
    max_examples=200,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(start=st.integers(0, len(OPEN_FIELD)), length=st.integers(0, 30), text=st.text(max_size=10))
@example(start=0, length=len(OPEN_FIELD), text="")
def test_mutated_text_gives_a_problem_or_our_error(
    tmp_path_factory: pytest.TempPathFactory, start: int, length: int, text: str
) -> None:
    """A piece of the file replaced by anything: a problem, or an error with the file in it."""
    path = tmp_path_factory.getbasetemp() / "mutated.toml"
    changed = OPEN_FIELD[:start] + text + OPEN_FIELD[start + length :]
    path.write_bytes(changed.encode("utf-8", "surrogatepass"))
    try:
        assert isinstance(load(path), Problem)
    except InputError as error:
        assert error.file == str(path)
