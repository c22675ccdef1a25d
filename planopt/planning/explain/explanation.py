"""Entries of an explanation: keys that prevent a verified plan, and coverage holes crossed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from planopt.channel.posterior import ChannelPosterior
from planopt.planning.holes import SHORTEST_IN_WORDS_M, Hole
from planopt.planning.plan import Plan
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.moving_obstacle import MovingDiscs


@dataclass(frozen=True, eq=False)
class Case:
    """One robot's plan from the start of a run."""

    problem: Problem  # With all robots
    number: int  # Of the robot
    posteriors: Sequence[ChannelPosterior]  # What the plan was made from, of each station
    plan: Plan  # The plan
    # What it must keep from: moving obstacles, and the plans of the other robots where a separation
    # is asked for
    moving: MovingDiscs

    @property
    def own(self) -> Problem:
        """The problem with this robot alone."""
        return problem_of_robot(self.problem, self.number)


LIMITS = ("robots[", "planner.", "world.")
"""Begins of keys that say what there is to do it with: nobody asks for them to be kept."""


@dataclass(frozen=True)
class Relaxation:
    """One key of the problem file that is at odds with the rest, and what of it would do.

    Any one relaxation of an explanation that is `verified` suffices.

    Attributes
    ----------
    constraint
        The key, such as ``constraints.p_min``.
    unit
        Of `value` and `relaxed_value`; empty for a probability or a count.
    value
        What is asked; None for an obstacle.
    stages
        Steps (1 is the first) at which it cannot be kept; empty where it is no matter of steps.
    shortfall, shortfall_unit
        By how much, at the worst of them; None where there is no number for it.
    relaxed_value
        The value nearest to `value` that was found to help; None for an obstacle, which must go.
    verified
        Whether the problem solved again with it has a verified plan.
    robot
        Whose plan it is about.
    """

    constraint: str
    unit: str
    value: float | None
    stages: tuple[int, ...]
    shortfall: float | None
    shortfall_unit: str
    relaxed_value: float | None
    verified: bool
    robot: str

    def __str__(self) -> str:
        """One sentence for people."""
        asked = self.constraint
        if self.value is not None:
            asked += f" = {_shown(self.value, self.unit)}"
        fails = "stands in the way" if self.constraint.startswith(LIMITS) else "cannot be kept"
        where = f" at steps {_ranges(self.stages)}" if self.stages else ""
        short = "" if self.shortfall is None else _shown(self.shortfall, self.shortfall_unit)
        by = f", short by {short}" if short else ""
        change = (
            "without it there is a plan"
            if self.relaxed_value is None
            else f"{_shown(self.relaxed_value, self.unit)} would do"
        )
        proof = "verified" if self.verified else "not verified"
        return f"{asked} {fails}{where}{by}; {change} ({proof} by solving again)"


@dataclass(frozen=True)
class Crossing:
    """The coverage holes that a way to a goal crosses, and the way with the best contact beside it.

    Attributes
    ----------
    robot
        Whose way it is.
    holes
        In the order of the way.
    cost_m
        What the cheapest way over the lattice costs, in metres at `outage_price`.
    outage_price
        ``objective.outage_price``.
    kept_m
        Length of the way that is out of contact for the fewest metres.
    outside_m
        How many those are: zero where a way keeps the bound all along.
    p_min
        The bound.
    """

    robot: str
    holes: tuple[Hole, ...]
    cost_m: float
    outage_price: float
    kept_m: float
    outside_m: float
    p_min: float

    @property
    def at_goal(self) -> bool:
        """Return whether the goal itself is below the bound."""
        return bool(self.holes) and self.holes[-1].to_end

    @property
    def why(self) -> str:
        """Return why they are crossed: what the way costs, and what keeps the bound instead."""
        instead = (
            f"the way that keeps it all along is {self.kept_m:.0f} m long"
            if self.outside_m < SHORTEST_IN_WORDS_M and not self.at_goal
            else f"no way keeps it: the best is out of contact for {self.outside_m:.1f} of its "
            f"{self.kept_m:.0f} m"
        )
        return (
            f"the way costs {self.cost_m:.0f} m at objective.outage_price {self.outage_price:g}, "
            f"and {instead}"
        )

    def __str__(self) -> str:
        """Return where the holes are, how long, and why they are crossed."""
        where = "; ".join(hole.words for hole in self.holes)
        goal = "; the goal is itself below it" if self.at_goal else ""
        return f"crosses {where}: below constraints.p_min {self.p_min:g}{goal}; {self.why}"


class Explanation(tuple[Relaxation | Crossing, ...]):
    """Relaxations and crossings, and in one sentence what they say together.

    Attributes
    ----------
    summary
        Whether the plans keep all bounds, and if not, whether anything that was tried helps.
    """

    summary: str

    def __new__(cls, found: Iterable[Relaxation | Crossing] = (), summary: str = "") -> Explanation:
        """Keep the entries, and the sentence."""
        made = super().__new__(cls, found)
        made.summary = summary
        return made

    def __str__(self) -> str:
        """Return the summary, and a line for each entry."""
        return "\n".join([self.summary, *map(str, self)])


def towards(value: float, step_digits: int, down: bool) -> float:
    """`value` rounded to so many significant digits, down or up: a number that can be typed in."""
    if value == 0.0 or not math.isfinite(value):
        return value
    unit = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - step_digits)
    rounded = (math.floor if down else math.ceil)(value / unit) * unit
    # Decimal digits, not what multiplying by a power of ten leaves.
    return float(f"{rounded:.{step_digits}g}")


def _shown(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".strip()


def _ranges(stages: tuple[int, ...]) -> str:
    """Steps as ``1-3, 5``."""
    parts: list[list[int]] = []
    for stage in stages:
        if parts and stage == parts[-1][-1] + 1:
            parts[-1].append(stage)
        else:
            parts.append([stage])
    return ", ".join(f"{p[0]}-{p[-1]}" if len(p) > 1 else f"{p[0]}" for p in parts)
