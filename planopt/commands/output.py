"""The output of commands: results to stdout, progress to stderr, files to --out.

Errors are raised; :func:`planopt.cli.main` prints them.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any

import typer

from planopt.commands.interrupts import interruptible
from planopt.errors import OutputError
from planopt.files.writing import Patterns, replaced_results

NO_PLAN = 4
"""Exit code where there is no plan, or a run did not arrive."""


def show(as_json: bool, data: Mapping[str, Any], text: str) -> None:
    """Print the JSON object if it was asked for, else the text."""
    if as_json:
        from planopt.files.writing import strict_text

        print_out(strict_text(data))
    else:
        from planopt.errors import escaped

        # Names and messages may come from any file, and a terminal obeys what it is sent.
        print_out("\n".join(escaped(line) for line in text.split("\n")) + "\n")


def print_out(text: str) -> None:
    """Write text to standard output at once."""
    with standard_output():
        typer.echo(text, nl=False)


@contextlib.contextmanager
def standard_output() -> Generator[None]:
    """Flush what the block prints; raise an OutputError if standard output is closed or full."""
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        if error.filename is not None:
            raise
        # Python flushes standard output again when it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OutputError(
            f"standard output cannot be written: {error.strerror or error}"
        ) from error


def say(text: str) -> None:
    """Print a line to stderr while work is going on."""
    from planopt.errors import escaped

    typer.echo(escaped(text), err=True)


@contextlib.contextmanager
def progress(description: str, total: int | None = None) -> Generator[Callable[[], None]]:
    """Show progress on stderr if it is a terminal; call the result for each part."""
    with interruptible() as stop_if_interrupted:
        with _bar(description, total) if sys.stderr.isatty() else _no_bar() as bar_advance:

            def advance() -> None:
                stop_if_interrupted()
                bar_advance()

            yield advance
        stop_if_interrupted()


@contextlib.contextmanager
def _no_bar() -> Generator[Callable[[], None]]:
    yield lambda: None


@contextlib.contextmanager
def _bar(description: str, total: int | None) -> Generator[Callable[[], None]]:
    """Draw a bar on stderr while the block runs; yield the function that advances it."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        *(() if total is None else (BarColumn(),)),
        TextColumn("{task.completed:.0f}" + ("" if total is None else f"/{total}")),
        TimeElapsedColumn(),
        *(() if total is None else (TextColumn("left:"), TimeRemainingColumn())),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=total)
        yield lambda: bar.advance(task)


@contextlib.contextmanager
def drawing(folder: Path | None, files: Patterns, *, wanted: bool) -> Generator[Path | None]:
    """Give a folder for the pictures of results that are saved; None where none are wanted.

    Pictures come after the results: whatever happens to them, the numbers are there.
    """
    if folder is None or not wanted:
        yield None
        return
    with progress("drawing"), replaced_results(folder, files, keep=True) as new:
        yield new


@contextlib.contextmanager
def results_folder(out: Path | None) -> Generator[Path | None]:
    """The folder for results, known to be writable before any work is done.

    If nothing comes of the work, a folder made for it is removed again.
    """
    if out is None:
        yield None
        return
    from planopt.files.writing import writable_folder

    existed = out.exists()
    try:
        # A signal may arrive at once after the folder was made.
        writable_folder(out)
        yield out
    except BaseException:
        if not existed:
            # Fails, rightly, where something was written.
            with contextlib.suppress(OSError):
                out.rmdir()
        raise
