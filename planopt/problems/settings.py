"""How the plans of a problem are found and drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from planopt.plain_values import make_plain
from planopt.problems.planner_kinds import OWN, planner_names

MIN_HORIZON, MAX_HORIZON = 1, 500


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
class PlannerSettings:
    """How plans are found.

    Attributes
    ----------
    step_s
        Duration of a step in seconds.
    name
        ``nlp`` (lattice, polish by IPOPT, verify), ``scp`` (the same with sequential convex
        programming), ``auto`` (the one that serves best, nlp), ``lattice`` (no polish), and for
        tasks other than reach ``one_step`` (dense local search one step ahead), ``random`` and
        ``lawnmower``, or a planner from outside (:mod:`planopt.problems.planner_kinds`).
    horizon
        Steps ahead, N.
    neighbours
        Measurements that the solver conditions each stage on.
    max_steps
        A closed loop that has not arrived by then ends.
    budget_s
        Seconds that a plan should take: the last polish begins, and ends, early enough for its
        proof; None for no limit.
    """

    step_s: Annotated[float, Field(gt=0, le=1e4, description="Duration of a step in seconds.")]
    name: Annotated[
        str,
        AfterValidator(known_planner),
        Field(
            examples=list(OWN),
            description="nlp (lattice, polish by IPOPT, verify), scp (polish by sequential convex "
            "programming), auto (the better of them, nlp), lattice (no polish), and for tasks "
            "other than reach one_step, random or lawnmower; or a planner that is registered.",
        ),
    ] = "auto"
    horizon: Annotated[
        int, Field(ge=MIN_HORIZON, le=MAX_HORIZON, description="Steps ahead (N).")
    ] = 10
    neighbours: Annotated[
        int,
        Field(
            ge=4,
            le=512,
            description="Measurements that the solver conditions each stage on (a number).",
        ),
    ] = 48
    max_steps: Annotated[
        int,
        Field(
            ge=1,
            le=100_000,
            description="A closed loop that has not arrived after this many steps ends.",
        ),
    ] = 400
    budget_s: Annotated[
        float | None,
        Field(
            gt=0,
            le=1e6,
            description="Seconds that a plan should take: the last polish begins, and ends, early "
            "enough for its proof; left out: no limit.",
        ),
    ] = None

    def __post_init__(self) -> None:
        make_plain(self)


@dataclass(frozen=True)
class ReportSettings:
    """What is drawn.

    Attributes
    ----------
    figures
        Whether pictures are drawn beside the results.
    """

    figures: Annotated[bool, Field(description="Draw the pictures (true or false).")] = True
