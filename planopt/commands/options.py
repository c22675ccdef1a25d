"""Shared parts of commands: options, output, results folders and interrupts."""

import contextlib
import dataclasses
import inspect
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Concatenate, ParamSpec, TypeVar, cast, get_type_hints

import typer

from planopt.errors import OutputError, escaped
from planopt.files.writing import Patterns, replaced_results, strict_text, writable_folder

PLANNERS = (
    "auto, nlp, scp, lattice, one_step, largest_deviation, random, random_disk, "
    "random_persistent, lawnmower, path_loss_only, informed_disk, unaware, oracle, oracle_log, "
    "clairvoyant, clairvoyant_log; networks: law, receding, deploy; pursuits: drive, retarget, "
    "receding"
)
"""Names of planners by task, for help texts; their registry would load NumPy."""


def option(name: str, metavar: str | None, text: str, **settings: Any) -> Any:
    """Return the declaration of an option."""
    return typer.Option(name, metavar=metavar, help=text, **settings)


ProblemArgument = Annotated[
    str, typer.Argument(metavar="PROBLEM", help="Problem file, or a name from `list`.")
]
ResultArgument = Annotated[
    Path, typer.Argument(metavar="PATH", help="The folder given as --out, or its JSON file.")
]
OutOption = Annotated[Path | None, option("--out", "DIR", "Folder for the results.")]
JsonOption = Annotated[
    bool, option("--json", None, "Print one JSON object on standard output, nothing else.")
]
AnimationOption = Annotated[
    bool, option("--animation", None, "Also save an animation, run.gif; needs --out.")
]
WorkersOption = Annotated[int, option("--workers", "N", "Number of processes.", min=1)]
FirstSeedOption = option("--first-seed", "N", "First random seed.", min=0)


@dataclass(frozen=True, kw_only=True)
class PlanningOptions:
    """Options of the commands that plan for one problem."""

    problem: ProblemArgument
    horizon: Annotated[
        int | None, option("--horizon", "N", "Planning horizon: steps ahead, 1 to 500.")
    ] = None
    planner: Annotated[str | None, option("--planner", "NAME", f"Planner: {PLANNERS}.")] = None
    cost_to_go: Annotated[
        str | None, option("--cost-to-go", "NAME", "Cost-to-go: geodesic or connected.")
    ] = None
    seed: Annotated[
        int,
        option("--seed", "N", "Random seed of fading and of initial measurement positions.", min=0),
    ] = 0
    out: OutOption = None
    json: JsonOption = False


@dataclass(frozen=True, kw_only=True)
class FormatOptions:
    """Options about the format of a power log."""

    columns: Annotated[
        str | None,
        option("--columns", "x=NAME,y=NAME,power=NAME", "Names of columns; default: detected."),
    ] = None
    censored: Annotated[
        str | None,
        option("--censored", "COLUMN", "Column that is 1 where the power is an upper limit."),
    ] = None
    floor: Annotated[
        float | None,
        option("--floor", "DBM", "Receiver sensitivity: powers at or below it are upper limits."),
    ] = None
    resolution: Annotated[
        float, option("--resolution", "DB", "Rounding step of the powers in the log.")
    ] = 0.0
    position_error: Annotated[
        float, option("--position-error", "M", "Standard deviation of x and y (GPS error).")
    ] = 0.0
    accuracy: Annotated[
        str | None,
        option("--accuracy", "COLUMN", "Column of position accuracies: 68 % radius in metres."),
    ] = None
    time: Annotated[
        str | None, option("--time", "COLUMN", "Column of times: seconds, Unix times or dates.")
    ] = None
    receiver: Annotated[
        str | None,
        option(
            "--receiver",
            "COLUMN",
            "Column of receivers; each has a power offset from the first one.",
        ),
    ] = None
    where: Annotated[
        list[str] | None,
        option(
            "--where",
            "COLUMN=VALUE",
            "Only rows with this value, such as those of one transmitter; may be repeated.",
        ),
    ] = None
    origin: Annotated[
        str | None,
        option(
            "--origin",
            "LAT,LON[,ANGLE]",
            "For logs in degrees: latitude and longitude of (0, 0), and the angle from east to x.",
        ),
    ] = None
    power_unit: Annotated[
        str | None,
        option("--power-unit", "dBm|mW", "Unit of powers; default: detected from name and values."),
    ] = None
    reader: Annotated[
        str | None, option("--reader", "NAME", "Program that wrote the log; default: detected.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class LogOptions(FormatOptions):
    """Options of the commands that fit the channel to a power log."""

    log: Annotated[Path, typer.Argument(metavar="LOG", help="Power log.")]
    station: Annotated[
        str | None,
        option(
            "--station",
            "X,Y[,HEIGHT]|unknown",
            "Position of the base station in metres, or LAT,LON[,HEIGHT] if --origin is given.",
        ),
    ] = None
    each: Annotated[
        str | None,
        option("--each", "COLUMN", "Treat each transmitter named in this column on its own."),
    ] = None
    stations: Annotated[
        Path | None,
        option("--stations", "FILE", "With --each: table of names and positions of transmitters."),
    ] = None
    method: Annotated[
        str,
        option("--method", "NAME", "Likelihood: map, reml; moments: lemma1, capped, convex, nls."),
    ] = "map"
    station_method: Annotated[
        str | None,
        option(
            "--station-method",
            "NAME",
            "Method to locate a station: joint (likelihood) or line (least squares).",
        ),
    ] = None
    forgetting: Annotated[
        float | None,
        option("--forgetting", "S", "Time constant of changes in shadowing; needs --time."),
    ] = None
    loss: Annotated[
        str,
        option("--loss", "NAME", "Loss function of --method convex: squares, huber or absolute."),
    ] = "squares"


Options = TypeVar("Options")
Own = ParamSpec("Own")


def with_options(
    options: type[Options],
) -> Callable[[Callable[Concatenate[Options, Own], int]], Callable[..., int]]:
    """Return a decorator that replaces a command's first parameter by fields of a dataclass."""

    def decorated(command: Callable[Concatenate[Options, Own], int]) -> Callable[..., int]:
        def run(**values: Any) -> int:
            shared = {name: values.pop(name) for name in names}
            return cast("Callable[..., int]", command)(options(**shared), **values)

        own = list(inspect.signature(command).parameters.values())[1:]
        hints = get_type_hints(command, include_extras=True)
        hints |= get_type_hints(options, include_extras=True)
        names = [field.name for field in dataclasses.fields(cast("Any", options))]
        shared = [inspect.signature(options).parameters[name] for name in names]
        parameters = [
            each.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[each.name])
            for each in (*shared, *own)
        ]
        run.__name__, run.__doc__ = command.__name__, command.__doc__
        run.__annotations__ = {each.name: each.annotation for each in parameters}
        vars(run)["__signature__"] = inspect.Signature(parameters)
        return run

    return decorated


NO_PLAN = 4  # Exit code if no plan exists or a run failed its task


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


CLEAR = "\x1b[H\x1b[2J"  # Control code that clears a terminal


def say(text: str, *, clear: bool = False) -> None:
    """Print progress to stderr, on a cleared terminal if `clear` is set."""
    words = "\n".join(escaped(line) for line in text.split("\n"))
    typer.echo(f"{CLEAR}{words}" if clear else words, err=True)


_active: list[list[int]] = []
"""Signals received by each active block of :func:`stopping`, the outermost first."""


IMPORTER = "<frozen importlib._bootstrap>"
DEFERRED_S = 0.05  # Time after which a signal that arrives during an import is raised again


def _stop(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code.co_filename == IMPORTER:
            # An interrupted import ends in an ImportError, or in SIGINT when Python exits.
            later = threading.Timer(DEFERRED_S, signal.raise_signal, (number,))
            later.daemon = True
            later.start()
            return
        frame = frame.f_back
    # A second SIGTERM must not interrupt the cleanup after the first.
    again = number == signal.SIGTERM and number in _active[-1]
    for received in _active:
        received.append(number)
    if not again:
        raise KeyboardInterrupt


@contextlib.contextmanager
def stopping() -> Generator[list[int]]:
    """Within the block, raise KeyboardInterrupt on SIGINT or SIGTERM; yield a list of signals."""
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


def was_interrupted() -> bool:
    """Return whether a SIGINT arrived that did not end the work, and forget it."""
    found = any(signal.SIGINT in received for received in _active)
    for received in _active:
        received[:] = [number for number in received if number != signal.SIGINT]
    return found


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
    """Yield a folder for figures to be added to the saved results; None if not `wanted`."""
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


@contextlib.contextmanager
def results_folders(folders: Iterable[Path | None]) -> Generator[None]:
    """Check that all folders are writable before any computation, as :func:`results_folder`."""
    with contextlib.ExitStack() as stack:
        for folder in folders:
            stack.enter_context(results_folder(folder))
        yield
