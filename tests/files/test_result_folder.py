"""Folders of results: the old files or the new, whatever happens and whenever."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from planopt import OutputError
from planopt.files.writing import STAGING, hidden_name, replaced_results, write_text

FILES = ("a.json", "b_*.npz", "*.png")


def contents(folder: Path) -> dict[str, str]:
    return {p.name: "folder" if p.is_dir() else p.read_text() for p in folder.iterdir()}


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A folder with an earlier result, and a file of the user's."""
    for name in ("a.json", "b_1.npz", "old.png", "notes.txt"):
        (tmp_path / name).write_text("old")
    return tmp_path


def test_new_files_replace_old_ones_and_pictures_are_added(old: Path) -> None:
    """Old files of the result are removed, those of the user stay; folders are made."""
    for folder in (old, old / "x" / "y"):
        with replaced_results(folder, FILES) as new:
            (new / "a.json").write_text("new")
            (new / "b_2.npz").write_text("new")
            assert new.parent == folder
        with replaced_results(folder, FILES, keep=True) as new:
            (new / "plan.png").write_text("new")
    expected = {"a.json": "new", "b_2.npz": "new", "plan.png": "new"}
    assert contents(old / "x" / "y") == expected
    assert contents(old) == expected | {"notes.txt": "old", "x": "folder"}


@pytest.mark.parametrize("error", [ValueError(), KeyboardInterrupt(), OutputError(), OSError(28)])
def test_an_error_leaves_the_old_files(old: Path, error: BaseException) -> None:
    """A full disk is an error of output."""
    before = contents(old)
    with pytest.raises(OutputError if isinstance(error, OSError) else type(error)):
        with replaced_results(old, FILES) as new:
            (new / "a.json").write_text("new")
            raise error
    assert contents(old) == before


def test_a_file_of_an_unknown_name_replaces_nothing(old: Path) -> None:
    before = contents(old)
    with pytest.raises(ValueError, match=r"extra\.csv"), replaced_results(old, FILES) as new:
        (new / "extra.csv").write_text("new")
    assert contents(old) == before


def test_errors_name_the_folder_of_the_user(old: Path) -> None:
    with pytest.raises(OutputError) as caught, replaced_results(old, FILES) as new:
        (new / "a.json").mkdir()
        write_text(new / "a.json", "text")
    assert STAGING not in str(caught.value) and str(old / "a.json") in str(caught.value)
    with pytest.raises(OutputError), replaced_results(old / "a.json", FILES):
        pass


def test_remains_of_killed_processes_are_removed(old: Path) -> None:
    """Files and folders of living processes and of other machines stay."""
    script = "from planopt.files.writing import hidden_name; print(hidden_name('.json'), end='')"
    dead = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True).stdout
    other = hidden_name().replace(STAGING, f"{STAGING}other-")
    (old / dead).mkdir()
    (old / dead / "a.json").write_text("half")
    (old / other).touch()
    with replaced_results(old, FILES) as living:
        (living / "a.json").write_text("first")
        with replaced_results(old, FILES) as new:
            (new / "a.json").write_text("second")
        assert contents(living) == {"a.json": "first"}
    assert contents(old) == {"a.json": "first", "notes.txt": "old", other: ""}


WRITER = """
import sys
from pathlib import Path
from planopt.files.writing import replaced_results
folder, number = Path(sys.argv[1]), 0
print("ready", flush=True)
while True:
    number += 1
    with replaced_results(folder, ("head.json", "*.new")) as new:
        for name in ("head.json", "1.new", "2.new", f"{number % 7}.new"):
            (new / name).write_text(str(number))
"""


def kills(folder: Path, count: int) -> None:
    """Kill a process that replaces results: a JSON file stands beside its own files alone."""
    for index in range(count):
        writer = subprocess.Popen([sys.executable, "-c", WRITER, folder], stdout=subprocess.PIPE)
        assert writer.stdout is not None
        writer.stdout.readline()
        time.sleep(0.002 + 0.0131 * (index % 7))
        writer.send_signal(signal.SIGKILL)
        writer.communicate(timeout=60)
        files = {path.name: path.read_text() for path in folder.iterdir() if path.is_file()}
        if "head.json" in files:
            number = int(files["head.json"])
            assert set(files) == {"head.json", "1.new", "2.new", f"{number % 7}.new"}
            assert set(files.values()) == {str(number)}
    with replaced_results(folder, ("head.json", "*.new")) as new:
        (new / "head.json").write_text("last")
    assert contents(folder) == {"head.json": "last"}


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
@pytest.mark.parametrize("count", [5, pytest.param(300, marks=pytest.mark.slow)])
def test_killed_at_any_moment(count: int, tmp_path: Path) -> None:
    """Old, new or no result, and the next one leaves nothing behind."""
    kills(tmp_path, count)
