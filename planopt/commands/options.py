"""Options shared by several commands."""

import dataclasses
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Concatenate, ParamSpec, TypeVar, cast, get_type_hints

import typer

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
        str, option("--method", "NAME", "Estimator: map, reml, lemma1, capped, convex or nls.")
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
