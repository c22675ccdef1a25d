"""How the plans of a problem are found and drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from planopt.plain_values import make_plain

MIN_HORIZON, MAX_HORIZON = 1, 500

Coordination = Literal["joint", "decoupled"]


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
    coordination
        ``joint``: each robot of a team is told what the others plan to measure, and its terms
        count what it adds to that; ``decoupled``: each counts as if it were alone.
    rounds
        How often the robots of a joint team plan in one step, one after the other: from the second
        round on a plan is exchanged only for one that is worth more to the team.
    budget_s
        Seconds that a plan should take: the last polish begins, and ends, early enough for its
        proof; None for no limit.
    """

    step_s: float
    name: str = "auto"
    horizon: int = 10
    neighbours: int = 48
    max_steps: int = 400
    budget_s: float | None = None
    coordination: Coordination = "joint"
    rounds: int = 1

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

    figures: bool = True
