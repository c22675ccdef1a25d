"""Settings of the planner and of the report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from planopt.problems.planner_kinds import OWN, planner_names
from planopt.problems.tables import Part

MIN_HORIZON, MAX_HORIZON = 1, 500

Coordination = Literal["joint", "decoupled"]


def known_planner(name: str) -> str:
    """Refuse the name of a planner that does not exist, in words of the schema."""
    known = planner_names()
    if name not in known:
        listed = ", ".join(f"'{each}'" for each in known[:-1])
        raise PydanticCustomError(
            "planner_name", "Input should be {names}", {"names": f"{listed} or '{known[-1]}'"}
        )
    return name


@dataclass(frozen=True, kw_only=True)
class PlannerSettings(Part):
    """The settings of the planner."""

    at = "planner"

    step_s: Annotated[float, Field(gt=0, le=1e4)]
    """Duration of a step in seconds."""
    name: Annotated[
        str,
        AfterValidator(known_planner),
        Field(
            examples=list(OWN),
            description="nlp (lattice, polish by IPOPT, verify), scp (polish by sequential convex "
            "programming), auto (the better of them, nlp), lattice (no polish), and for tasks "
            "other than reach a baseline: "
            f"{', '.join(name for name, kind in OWN.items() if not kind.reaches_goals)}; or a "
            "planner that is registered.",
        ),
    ] = "auto"
    horizon: Annotated[int, Field(ge=MIN_HORIZON, le=MAX_HORIZON)] = 10
    """Steps ahead (N)."""
    neighbours: Annotated[int, Field(ge=4, le=512)] = 48
    """Measurements that the solver conditions each stage on (a number)."""
    max_steps: Annotated[int, Field(ge=1, le=100_000)] = 400
    """A closed loop that has not arrived after this many steps ends."""
    budget_s: Annotated[float | None, Field(gt=0, le=1e6)] = None
    """Seconds that a plan should take: the last polish begins, and ends, early enough for its
    proof; left out: no limit."""
    coordination: Coordination = "joint"
    """For several robots: joint (each is told what the others plan to measure, and counts what it
    adds) or decoupled (each counts as if it were alone)."""
    rounds: Annotated[int, Field(ge=1, le=10)] = 1
    """How often the robots of a joint team plan in one step, in turn (a number); later rounds take
    time, and never lessen what the team's plans are worth together."""


@dataclass(frozen=True)
class ReportSettings(Part):
    """The settings of the report."""

    at = "report"

    figures: bool = True
    """Draw the pictures (true or false)."""
