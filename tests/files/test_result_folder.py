"""Folders of results: the old files or the new, whatever happens and whenever."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from planopt.errors import InputError, OutputError
from planopt.files.result_folder import (
    MIXED,
    STAGING,
    ResultFiles,
    added_results,
    replaced_results,
    require_one_result,
)
from planopt.files.whole import write_text

FILES = ResultFiles("test", ("a.json", "b_*.npz", "*.png"))


def contents(folder: Path) -> dict[str, str]:
    """Every file and folder in `folder`."""
    return {p.name: "folder" if p.is_dir() else p.read_text() for p in folder.iterdir()}


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A folder with an earlier result, and a file of the user's."""
    for name in ("a.json", "b_1.npz", "old.png", "notes.txt"):
        (tmp_path / name).write_text("old")
    return tmp_path


def test_the_new_files_replace_the_old(old: Path) -> None:
    """Those that are not written anew are removed; others stay; nothing else is left."""
    with replaced_results(old, FILES) as new:
        (new / "a.json").write_text("new")
        (new / "b_2.npz").write_text("new")
        assert new.parent == old and contents(old)["a.json"] == "old"
    assert contents(old) == {"a.json": "new", "b_2.npz": "new", "notes.txt": "old"}


def test_a_folder_is_made(tmp_path: Path) -> None:
    """With those above it."""
    with replaced_results(tmp_path / "x" / "y", FILES) as new:
        (new / "a.json").write_text("new")
    assert contents(tmp_path / "x" / "y") == {"a.json": "new"}


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, OutputError("full")])
def test_whatever_ends_the_block_leaves_the_old_files(old: Path, error) -> None:
    """To the byte, and without a trace."""
    before = contents(old)
    with pytest.raises(error if isinstance(error, type) else type(error)):
        with replaced_results(old, FILES) as new:
            (new / "a.json").write_text("new")
            raise error
    assert contents(old) == before


def test_pictures_that_follow(old: Path) -> None:
    """Between results and pictures a marker says what is missing, and old pictures are gone."""
    with replaced_results(old, FILES, pictures_follow=True) as new:
        (new / "a.json").write_text("new")
    assert "Pictures" in (old / FILES.marker).read_text()
    require_one_result(old, FILES)
    with pytest.raises(ValueError), added_results(old, FILES) as new:
        (new / "plan.png").write_text("new")
        raise ValueError
    assert not list(old.glob("*.png")) and (old / FILES.marker).exists()
    with added_results(old, FILES) as new:
        (new / "plan.png").write_text("new")
    assert contents(old) == {"a.json": "new", "plan.png": "new", "notes.txt": "old"}


def test_a_file_that_is_not_known_is_a_fault_of_ours(old: Path) -> None:
    """It would outlive its result: nothing is replaced."""
    before = contents(old)
    with pytest.raises(ValueError, match=r"extra\.csv"), replaced_results(old, FILES) as new:
        (new / "extra.csv").write_text("new")
    assert contents(old) == before


def test_a_folder_of_two_results_is_refused(old: Path) -> None:
    """Only by the marker of its kind."""
    require_one_result(old, FILES)
    (old / FILES.marker).write_text(MIXED)
    with pytest.raises(InputError, match="files of two results"):
        require_one_result(old, FILES)
    require_one_result(old, ResultFiles("other", ("*",)))


def test_what_cannot_be_written_is_named_as_the_user_did(old: Path) -> None:
    """Not by the hidden folder."""
    with pytest.raises(OutputError) as caught, replaced_results(old, FILES) as new:
        (new / "a.json").mkdir()
        write_text(new / "a.json", "text")
    assert STAGING not in str(caught.value) and str(old / "a.json") in str(caught.value)
    with pytest.raises(OutputError), replaced_results(old / "a.json", FILES):
        pass


def test_what_a_killed_process_left_is_removed(old: Path) -> None:
    """But not what a living one writes into."""
    (old / f"{STAGING}dead").mkdir()
    (old / f"{STAGING}dead" / "a.json").write_text("half")
    with replaced_results(old, FILES) as living:
        (living / "a.json").write_text("first")
        with replaced_results(old, FILES) as new:
            (new / "a.json").write_text("second")
        assert contents(living) == {"a.json": "first"}
    assert contents(old) == {"a.json": "first", "notes.txt": "old"}


WRITER = """
import sys
from pathlib import Path
from planopt.files.result_folder import ResultFiles, added_results, replaced_results
files = ResultFiles("test", ("*.txt.new", "*.png"))
folder, number = Path(sys.argv[1]), 0
print("ready", flush=True)
while True:
    number += 1
    with replaced_results(folder, files, pictures_follow=number % 2 == 0) as new:
        for i in range(4):
            (new / f"{i}.txt.new").write_text(str(number))
    if number % 2 == 0:
        with added_results(folder, files) as new:
            (new / "a.png").write_text(str(number))
"""


def killed(folder: Path, after_s: float, number: signal.Signals) -> None:
    """Let a process replace results again and again, and kill it at some moment."""
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert writer.stdout is not None
    writer.stdout.readline()
    time.sleep(after_s)
    writer.send_signal(number)
    writer.communicate(timeout=60)


def is_whole(folder: Path) -> bool:
    """Whether the files are of one result, or a marker says that they are not."""
    files = {path.name: path.read_text() for path in folder.iterdir() if path.is_file()}
    marker = files.pop("INCOMPLETE_test.txt", "")
    pictures = files.pop("a.png", None)
    if marker == MIXED:
        return True
    numbers = set(files.values())
    if len(numbers) > 1 or (files and len(files) != 4):
        return False
    if pictures is not None:
        return {pictures} == numbers
    return not files or int(numbers.pop()) % 2 == 1 or bool(marker)


def kills(folder: Path, count: int, check: Callable[[Path], bool]) -> None:
    """Kill the writer at many moments and look at the folder each time."""
    for index in range(count):
        killed(folder, 0.002 + 0.0131 * (index % 7), signal.SIGKILL)
        assert check(folder), contents(folder)
    with replaced_results(folder, ResultFiles("test", ("*.txt.new", "*.png"))) as new:
        (new / "0.txt.new").write_text("last")
    assert contents(folder) == {"0.txt.new": "last"}


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_killed_at_a_few_moments(tmp_path: Path) -> None:
    """The small version of the test below."""
    kills(tmp_path, 5, is_whole)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_killed_at_any_moment(tmp_path: Path) -> None:
    """Old, new, or marked; the next result leaves nothing of what was killed."""
    kills(tmp_path, 300, is_whole)
