"""Loading files: what they hold, one clear error for what cannot be read, and fuzzing."""

import copy
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from refusals import refused

from planopt import InputError, Problem, load
from planopt.channel import LogFormat
from planopt.problems import LoggedMeasurements, RasterTruth, problem_from_dict, problem_to_dict
from planopt.problems.library import library_folder, read_toml

OPEN_FIELD = (library_folder() / "open_field.toml").read_text(encoding="utf-8")


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "p.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_byte_order_mark_and_carriage_returns_are_read(tmp_path: Path) -> None:
    """Files from Windows editors load like any other."""
    text = "\ufeff" + OPEN_FIELD.replace("\n", "\r\n")
    assert load(written(tmp_path, text)).robots == load("open_field").robots


def test_relative_files_start_at_the_problem_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder that the program runs in does not matter, and loaded paths are absolute."""
    folder = tmp_path / "deep"
    folder.mkdir()
    (folder / "log.csv").write_text("x_m,y_m,power_dbm\n")
    (folder / "map.npz").touch()
    (folder / "area.wkt").write_text("POLYGON ((84 60, 102 60, 102 72, 84 60))")
    text = OPEN_FIELD.replace("count = 120", 'file = "log.csv"\ncolumns = { power = "rssi" }')
    written(
        folder,
        text.replace('kind = "model"', 'kind = "raster"\nfile = "map.npz"\nfloor_db = -130')
        .replace("k_pl_db = -30.0\nn_pl = 2.4\nshadow_std_db = 4.0\n", "")
        .replace("decorrelation_m = 15.0\nmultipath_std_db = 1.5\ncell_m = 1.0\n", "")
        .replace("[channel.truth]", '[[world.obstacles]]\nfile = "area.wkt"\n\n[channel.truth]'),
    )
    monkeypatch.chdir(tmp_path)
    problem = load("deep/p.toml")
    assert problem.channel.measurements == LoggedMeasurements(
        folder / "log.csv", LogFormat((None, None, "rssi"))
    )
    assert problem.channel.truth == RasterTruth(file=folder / "map.npz", floor_db=-130.0)
    assert problem.workspace.obstacles[-1].polygon.area == pytest.approx(108)
    (folder / "log.csv").unlink()
    with refused() as caught:
        load("deep/p.toml")
    assert caught.value.key == "channel.measurements.file"
    (folder / "map.npz").unlink()
    with refused() as caught:
        load("deep/p.toml")
    assert caught.value.key == "channel.truth.file"


@pytest.mark.parametrize(
    ("text", "row"),
    [
        ("[problem]\nschema = 1\nname = \n", 3),
        ("[problem]\nschema = [1,\n", 2),
        ("a = 1\na = 2\n", 2),
        ("a = " + "[" * 5000, None),
        ("a = " + "9" * 5000, None),
        (b"a = '\xff'", None),
        ("", None),
    ],
)
def test_text_that_is_no_problem_is_one_error(
    tmp_path: Path, text: str | bytes, row: int | None
) -> None:
    """A file that does not parse is an error with its file, and its line where there is one."""
    path = written(tmp_path, text)
    with refused() as caught:
        load(path)
    assert caught.value.file == str(path)
    assert caught.value.row == row


TRUTH = OPEN_FIELD[OPEN_FIELD.index("[channel.truth]") :]
TRUTH = TRUTH[: TRUTH.index("\n[channel.m")]
RASTER = '[channel.truth]\nkind = "raster"\nfile = "map.asc"\nfloor_db = -130.0\n'


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('wkt = "POLYGON', 'file = "a.wkt" #'),
        ("[102.0, 60.0], [102.0, 72.0]", "[102.0, 72.0], [102.0, 60.0]"),
        ("count = 120", f'file = "{"x" * 300}"'),
        (TRUTH, RASTER),
    ],
)
def test_faults_of_other_files_name_file_and_key(tmp_path: Path, old: str, new: str) -> None:
    """The file that is wrong, and the key that names it."""
    (tmp_path / "a.wkt").write_text("POINT (1 2)")
    (tmp_path / "map.asc").write_text("")
    assert old in OPEN_FIELD
    text = OPEN_FIELD.replace(old, new)
    text = text.replace('name = "pond"\n', "") if "a.wkt" in new else text
    with refused():
        load(written(tmp_path, text))


@pytest.mark.parametrize(
    "name", [".", "munich_curier", "none.toml", "no/such.toml", "x" * 300, "a\0b", "", "\ud800"]
)
def test_what_is_not_there_is_one_error(name: str) -> None:
    """Folders, slips, and names that the file system has not, or would not even take."""
    with refused():
        load(name)


def test_file_that_cannot_be_read_is_one_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: Path) -> os.stat_result:
        raise OSError(5, "Input/output error")

    path = written(tmp_path, OPEN_FIELD)
    monkeypatch.setattr(Path, "stat", fail)
    with refused():
        read_toml(path)


Build = Callable[[object], Problem]

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
        action = data.draw(st.sampled_from(["replace", "delete", "printable", "add"]))
        if action == "replace":
            table[last] = data.draw(VALUES)
        elif action == "delete" or isinstance(table, list):
            del table[last]
        elif action == "printable":
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
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
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
