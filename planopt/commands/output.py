"""Output of commands (results to stdout, progress to stderr, files to --out) and interrupts."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any

import typer

from planopt.errors import OutputError, escaped
from planopt.files.writing import Patterns, replaced_results, strict_text, writable_folder

NO_PLAN = 4
"""Exit code if no plan exists or a run failed its task."""


def show(as_json: bool, data: Mapping[str, Any], text: str) -> None:
    """Print the JSON object if `as_json` is set, else the text."""
    if as_json:
        print_out(strict_text(data))
    else:
        # Names and messages may come from any file and contain terminal control codes.
        print_out("\n".join(escaped(line) for line in text.split("\n")) + "\n")


def print_out(text: str) -> None:
    """Write text to standard output and flush it."""
    with standard_output():
        typer.echo(text, nl=False)


@contextlib.contextmanager
def standard_output() -> Generator[None]:
    """Flush the output of the block; raise an OutputError if standard output is closed or full."""
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        if error.filename is not None:
            raise
        # Python flushes standard output again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OutputError(f"cannot write to standard output: {error.strerror or error}") from error


CLEAR = "\x1b[H\x1b[2J"
"""Control code that clears a terminal."""


def say(text: str, *, clear: bool = False) -> None:
    """Print progress to stderr, on a cleared terminal if `clear` is set."""
    words = "\n".join(escaped(line) for line in text.split("\n"))
    typer.echo(f"{CLEAR}{words}" if clear else words, err=True)


_active: list[list[int]] = []
"""Signals received by each active block of :func:`stopping`, the outermost first."""


def _stop(number: int, _: object) -> None:
    # A second SIGTERM must not interrupt the cleanup after the first.
    again = number == signal.SIGTERM and number in _active[-1]
    for received in _active:
        received.append(number)
    if not again:
        raise KeyboardInterrupt


@contextlib.contextmanager
def stopping() -> Generator[list[int]]:
    """Raise KeyboardInterrupt on SIGINT and SIGTERM in the block; yield the signals received."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    _active.append(received)
    before = {number: signal.signal(number, _stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        _active.pop()


@contextlib.contextmanager
def progress(
    description: str, total: int | None = None, *, bar: bool = True
) -> Generator[Callable[[], None]]:
    """Show progress on stderr if it is a terminal; yield a function to call after each part."""
    if any(_active):
        raise KeyboardInterrupt
    with stopping() as received:
        shown = bar and sys.stderr.isatty()
        with _bar(description, total) if shown else contextlib.nullcontext() as advance_bar:

            def advance() -> None:
                if received:
                    raise KeyboardInterrupt
                if advance_bar is not None:
                    advance_bar()

            yield advance
        if received:
            raise KeyboardInterrupt


@contextlib.contextmanager
def _bar(description: str, total: int | None) -> Generator[Callable[[], None]]:
    """Show a progress bar on stderr within the block; yield the function that advances it."""
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
        TextColumn("{task.completed:.0f}" + ("" if total is None else "/{task.total:.0f}")),
        TimeElapsedColumn(),
        *(() if total is None else (TextColumn("left:"), TimeRemainingColumn())),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=total)
        yield lambda: bar.advance(task)
        # A run may end before its last possible step.
        bar.update(task, total=bar.tasks[0].completed)


@contextlib.contextmanager
def drawing(folder: Path | None, files: Patterns, *, wanted: bool) -> Generator[Path | None]:
    """Yield a folder for figures, which are then added to the saved results, or None."""
    if folder is None or not wanted:
        yield None
        return
    with progress("drawing"), replaced_results(folder, files, keep=True) as new:
        yield new


@contextlib.contextmanager
def results_folder(out: Path | None) -> Generator[Path | None]:
    """Yield the results folder after checking that it is writable; remove it after a failure."""
    if out is None:
        yield None
        return
    existed = out.exists()
    try:
        # A signal may arrive right after the folder is created.
        writable_folder(out)
        yield out
    except BaseException:
        if not existed:
            # Removal fails, as intended, if the folder has content.
            with contextlib.suppress(OSError):
                out.rmdir()
        raise
