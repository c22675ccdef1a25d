"""Entries of an explanation: keys that prevent a verified plan, and crossed coverage holes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from planopt.planning.certificate import SHORTEST_IN_WORDS_M, Hole, steps_in_words

LIMITS = ("robots[", "planner.", "world.")
"""Prefixes of keys that limit the robot or the planner, rather than state a requirement."""


@dataclass(frozen=True)
class Relaxation:
    """Key of the problem file that prevents a verified plan, and a value that would suffice.

    Each relaxation with ``verified=True`` is sufficient by itself.

    Attributes
    ----------
    constraint
        Problem file key, such as ``constraints.p_min``.
    unit
        Unit of `value` and `relaxed_value`; empty for a probability or a count.
    value
        The required value; None for an obstacle.
    stages
        Steps (1 is the first) that violate the constraint; empty if it does not apply to steps.
    shortfall, shortfall_unit
        Largest violation over these steps with its unit; None if not numerical.
    relaxed_value
        Sufficient value found nearest to `value`; None for an obstacle, which has to be
        removed.
    verified
        Whether the problem solved with this relaxation has a verified plan.
    robot
        Name of the robot.
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
        """Return a sentence that describes the relaxation."""
        key = self.constraint
        if self.value is not None:
            key += f" = {_shown(self.value, self.unit)}"
        fails = "prevents a plan" if self.constraint.startswith(LIMITS) else "cannot be met"
        where = f" at {steps_in_words(self.stages)}" if self.stages else ""
        short = "" if self.shortfall is None else _shown(self.shortfall, self.shortfall_unit)
        by = f", short by {short}" if short else ""
        change = (
            "without it there is a plan"
            if self.relaxed_value is None
            else f"{_shown(self.relaxed_value, self.unit)} would suffice"
        )
        proof = "confirmed" if self.verified else "not confirmed"
        return f"{key} {fails}{where}{by}; {change} ({proof} by solving again)"


@dataclass(frozen=True)
class Crossing:
    """Coverage holes on a path to a goal, and the path with the least outage.

    Attributes
    ----------
    robot
        Name of the robot.
    holes
        Coverage holes in path order.
    cost_m
        Cost of the cheapest lattice path, in metres at `outage_price`.
    outage_price
        Value of ``objective.outage_price``.
    kept_m
        Length of the path with the shortest distance out of contact.
    outside_m
        Distance out of contact on that path; zero if it satisfies the chance constraint.
    p_min
        Required probability of connection.
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
        """Return whether the goal itself violates p_min."""
        return bool(self.holes) and self.holes[-1].to_end

    @property
    def why(self) -> str:
        """Return the cost of the path, and the alternative that stays connected."""
        cost = (
            f"The planned route has a priced length of {self.cost_m:.0f} m: its length plus "
            f"{self.outage_price:g} m for each metre expected out of contact."
        )
        if self.outside_m < SHORTEST_IN_WORDS_M and not self.at_goal:
            return f"The shortest route that stays connected is {self.kept_m:.0f} m long. {cost}"
        length, outside = f"{self.kept_m:.0f} m", f"{self.outside_m:.0f} m"
        part = f"all of its {length}" if outside == length else f"{outside} of its {length}"
        return (
            "No route stays connected throughout. The route with the least outage has P(connected) "
            f"below {self.p_min:g} over {part}. {cost}"
        )

    def __str__(self) -> str:
        """Return locations and lengths of the holes, and why they are crossed."""
        where = "; ".join(hole.words for hole in self.holes)
        goal = ", also at the goal itself" if self.at_goal else ""
        return f"P(connected) is below {self.p_min:g} for {where}{goal}. {self.why}"


class Explanation(tuple[Relaxation | Crossing, ...]):
    """Tuple of relaxations and crossings, with a summary.

    Attributes
    ----------
    summary
        Text that says whether all plans are verified and, if not, whether a tested change helps.
    """

    summary: str

    def __new__(cls, found: Iterable[Relaxation | Crossing] = (), summary: str = "") -> Explanation:
        """Create the tuple with its summary."""
        made = super().__new__(cls, found)
        made.summary = summary
        return made

    def __str__(self) -> str:
        """Return the summary, and a line for each entry."""
        return "\n".join([self.summary, *map(str, self)])


def _shown(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".strip()
