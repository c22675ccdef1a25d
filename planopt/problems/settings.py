"""How the plans of a problem are found and drawn."""

from __future__ import annotations

from dataclasses import dataclass

from planopt.plain_values import make_plain

MIN_HORIZON, MAX_HORIZON = 1, 500


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

    step_s: float
    name: str = "auto"
    horizon: int = 10
    neighbours: int = 48
    max_steps: int = 400
    budget_s: float | None = None

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
