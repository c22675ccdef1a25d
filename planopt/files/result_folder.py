"""Replace all files of a result in a folder together.

New files are written into a hidden folder and moved when all of them exist. JSON files, without
which no result is read, are removed first and moved last: a process that is killed between these
leaves no result rather than a mixture of two.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
from collections.abc import Generator
from fnmatch import fnmatch
from pathlib import Path

from planopt.errors import OutputError
from planopt.files.whole import hidden_name, remove_remains

Patterns = tuple[str, ...]
"""Names of all files of a kind of result, with * for any text."""


@contextlib.contextmanager
def replaced_results(folder: Path, files: Patterns, *, keep: bool = False) -> Generator[Path]:
    """Yield a folder for new results, which replace those of `folder` unless an error occurs.

    With `keep` they are added to the results that are there.
    """
    staging = folder / hidden_name()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_remains(folder)
        staging.mkdir()
        yield staging
        names = sorted(os.listdir(staging), key=_is_head)
        unknown = [name for name in names if not _matches(name, files)]
        if unknown:
            raise ValueError(f"{unknown} are none of {files}")
        with _uninterrupted():
            for old in sorted(os.listdir(folder), key=_is_head, reverse=True):
                if not keep and _matches(old, files) and (_is_head(old) or old not in names):
                    (folder / old).unlink()
            for name in names:
                (staging / name).replace(folder / name)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from error
    except OutputError as error:
        raise OutputError(str(error).replace(str(staging), str(folder))) from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _matches(name: str, files: Patterns) -> bool:
    return any(fnmatch(name, pattern) for pattern in files)


def _is_head(name: str) -> bool:
    return name.endswith(".json")


@contextlib.contextmanager
def _uninterrupted() -> Generator[None]:
    """Delay interrupts while files are moved, where the system can."""
    if os.name != "posix":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
