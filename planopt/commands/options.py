"""Options that several commands share."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Concatenate, ParamSpec, TypeVar, cast, get_type_hints

import typer

from planopt.problems.planner_kinds import OWN

PLANNERS = ", ".join(OWN)

ProblemArgument = Annotated[
    str, typer.Argument(metavar="PROBLEM", help="A problem file, or a name that `list` shows.")
]
OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder to save the results in.")
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on standard output, nothing else.")
]
AnimationOption = Annotated[
    bool, typer.Option("--animation", help="Save the run as an animation too, run.gif in --out.")
]


@dataclass(frozen=True, kw_only=True)
class PlanningOptions:
    """The options of every command that plans for one problem, as given."""

    problem: ProblemArgument
    horizon: Annotated[
        int | None,
        typer.Option("--horizon", metavar="N", help="Planning horizon: steps ahead, 1 to 500."),
    ] = None
    planner: Annotated[
        str | None, typer.Option("--planner", metavar="NAME", help=f"Planner: {PLANNERS}.")
    ] = None
    cost_to_go: Annotated[
        str | None,
        typer.Option("--cost-to-go", metavar="NAME", help="Cost-to-go: geodesic or connected."),
    ] = None
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="Random seed of fading and measured places.")
    ] = 0
    out: OutOption = None
    json: JsonOption = False


Options = TypeVar("Options")
Own = ParamSpec("Own")


def with_options(
    options: type[Options],
) -> Callable[[Callable[Concatenate[Options, Own], int]], Callable[..., int]]:
    """Let a command take the fields of a dataclass of options in place of its first parameter."""
    fields = dataclasses.fields(cast("Any", options))

    def decorated(command: Callable[Concatenate[Options, Own], int]) -> Callable[..., int]:
        def run(**values: Any) -> int:
            shared = {field.name: values.pop(field.name) for field in fields}
            return cast("Callable[..., int]", command)(options(**shared), **values)

        hints = get_type_hints(options, include_extras=True)
        shared = [
            inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty
                if field.default is dataclasses.MISSING
                else field.default,
                annotation=hints[field.name],
            )
            for field in fields
        ]
        hints = get_type_hints(command, include_extras=True)
        own = [
            each.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[each.name])
            for each in list(inspect.signature(command).parameters.values())[1:]
        ]
        run.__name__, run.__doc__ = command.__name__, command.__doc__
        run.__annotations__ = {each.name: each.annotation for each in (*shared, *own)}
        vars(run)["__signature__"] = inspect.Signature([*shared, *own])
        return run

    return decorated
