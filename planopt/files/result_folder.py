"""Replace folders of results as a whole: they hold the old files or the new, never some of each.

New files are written into a hidden folder within, and moved into place when all are there. The few
milliseconds that this takes are the only time when the folder holds files of two results; a marker
says so meanwhile, and stays if the process is killed then. Pictures may follow the results that
they are of; until they are there another marker says that they are missing.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import tempfile
from collections.abc import Generator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from planopt.errors import InputError, OutputError
from planopt.files.whole import write_text

STAGING = ".planopt-new-"
"""What names of folders with files that are not yet in place begin with."""

MIXED = (
    "Files of two results stand in this folder: planopt was stopped while it replaced old ones by\n"
    "new ones. Run the command again.\n"
)
UNDRAWN = (
    "Pictures of the results in this folder are missing: planopt was stopped before they were\n"
    "drawn. The other files are complete.\n"
)


@dataclass(frozen=True)
class ResultFiles:
    """The files that one kind of result consists of."""

    kind: str  # Name of the kind, for the marker
    # Names of all its files, with * for any text. Files of these names are replaced together;
    # others in the folder are left alone.
    patterns: tuple[str, ...]

    @property
    def marker(self) -> str:
        """Name of the file that says that results of this kind are incomplete."""
        return f"INCOMPLETE_{self.kind}.txt"

    def includes(self, name: str) -> bool:
        """Return whether a file of this name is one of them."""
        return any(fnmatch(name, pattern) for pattern in self.patterns)


@contextlib.contextmanager
def replaced_results(
    folder: Path, files: ResultFiles, *, pictures_follow: bool = False
) -> Generator[Path]:
    """Give a folder to write new results into; on leaving they replace those of `folder`.

    If an error or an interrupt ends the block, the old results stay as they are.
    """
    with _staged(folder) as staging:
        yield staging
        names = _written(staging, files)
        with _uninterrupted():
            _mark(folder, staging, files, MIXED)
            for name in names:
                (staging / name).replace(folder / name)
            for old in list(folder.iterdir()):
                if files.includes(old.name) and old.name not in names:
                    old.unlink()
            if pictures_follow:
                _mark(folder, staging, files, UNDRAWN)
            else:
                (folder / files.marker).unlink()


@contextlib.contextmanager
def added_results(folder: Path, files: ResultFiles) -> Generator[Path]:
    """Give a folder to write pictures into; on leaving they join the results in `folder`."""
    with _staged(folder) as staging:
        yield staging
        names = _written(staging, files)
        with _uninterrupted():
            for name in names:
                (staging / name).replace(folder / name)
            (folder / files.marker).unlink(missing_ok=True)


def require_one_result(folder: Path, files: ResultFiles) -> None:
    """Refuse a folder that holds files of two results."""
    try:
        mixed = (folder / files.marker).read_bytes()[: len(MIXED)] == MIXED.encode()
    except OSError:
        return
    if mixed:
        raise InputError(
            "holds files of two results, because planopt was killed while it replaced them",
            file=folder,
            remedy="run the command again",
        )


def _mark(folder: Path, staging: Path, files: ResultFiles, text: str) -> None:
    """Write the marker within `staging`, where nothing of it outlives a kill, and move it out."""
    write_text(staging / files.marker, text)
    (staging / files.marker).replace(folder / files.marker)


def _written(staging: Path, files: ResultFiles) -> list[str]:
    """Names of the new files, all of which must be known: others would outlive their results."""
    names = sorted(path.name for path in staging.iterdir())
    unknown = [name for name in names if not files.includes(name)]
    if unknown:
        raise ValueError(f"{unknown} are none of {files.patterns}")
    return names


@contextlib.contextmanager
def _staged(folder: Path) -> Generator[Path]:
    """A folder within `folder` for files that are not yet in place, removed whatever happens."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for left in folder.glob(f"{STAGING}*"):
            if _is_abandoned(left):
                shutil.rmtree(left, ignore_errors=True)
        staging = Path(tempfile.mkdtemp(prefix=STAGING, dir=folder))
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from error
    try:
        with _held(staging):
            yield staging
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from error
    except OutputError as error:
        raise OutputError(str(error).replace(str(staging), str(folder))) from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)


@contextlib.contextmanager
def _held(staging: Path) -> Generator[None]:
    """Mark a folder as one that a living process writes into."""
    handle = _lock(staging)
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


def _is_abandoned(staging: Path) -> bool:
    """Return whether a folder's writer was killed; the system then ended its lock."""
    handle = _lock(staging)
    if handle is None:
        return False
    os.close(handle)
    return True


def _lock(staging: Path) -> int | None:
    """A handle that holds the lock of a folder, or None where that cannot be had."""
    if os.name != "posix":
        return None
    import fcntl

    try:
        handle = os.open(staging, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle


@contextlib.contextmanager
def _uninterrupted() -> Generator[None]:
    """Put off interrupts while files are moved, where the system can."""
    if os.name != "posix":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
