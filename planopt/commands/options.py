"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planopt.problems.planner_kinds import OWN

PLANNERS = ", ".join(OWN)

ProblemArgument = Annotated[
    str, typer.Argument(metavar="PROBLEM", help="A problem file, or a name that `list` shows.")
]
HorizonOption = Annotated[
    int | None,
    typer.Option("--horizon", metavar="N", help="Planning horizon: steps ahead, 1 to 500."),
]
PlannerOption = Annotated[
    str | None,
    typer.Option("--planner", metavar="NAME", help=f"Planner: {PLANNERS}."),
]
CostToGoOption = Annotated[
    str | None,
    typer.Option("--cost-to-go", metavar="NAME", help="Cost-to-go: geodesic or connected."),
]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Random seed of fading and measured places.")
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
