"""The tables ``[objective]`` and ``[[targets]]`` of a problem file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from planopt.problems.objective_forms import CostToGo, ReachObjective, Term
from planopt.problems.tables import Name, Pair, Table
from planopt.problems.target import Target
from planopt.problems.term_tables import ANY_TERM

LEAST_STD = 1e-6
"""Of a first estimate in metres or m/s: its information is still a number that can be inverted."""

Deviation = Annotated[float, Field(ge=0, le=1e6)]


class ObjectiveTable(Table):
    """``[objective]``: to reach a goal, time plus effort; for other tasks a sum of terms."""

    effort_weight_s2_m2: float = Field(
        default=ReachObjective.effort_weight_s2_m2,
        ge=0,
        le=1e6,
        description="Weight of speed squared in the cost rate 1 + weight * speed^2, in s^2/m^2.",
    )
    cost_to_go: CostToGo = Field(
        default=ReachObjective.cost_to_go,
        description="Beyond the horizon: geodesic (shortest path round the obstacles) or connected "
        "(cheapest path at the outage price).",
    )
    outage_price: float = Field(
        default=ReachObjective.outage_price,
        ge=0,
        le=1e6,
        description="A metre driven where the probability of connection P is below p_min counts "
        "1 + outage_price (1 - P) metres (a number). constraints.slack_max_db = 0 forbids it.",
    )
    terms: list[Annotated[Term, ANY_TERM]] = Field(
        default=[],
        description="For tasks other than reach: the weighted sum to be maximised; the first term "
        "is the task's.",
    )


class TargetTable(Table):
    """``[[targets]]``: a moving target and what is known of it at the start."""

    name: Name = Field(default=Target.name, description="What outputs call it.")
    start_m: Pair = Field(description="Where it truly starts, [x, y] in metres.")
    velocity_m_s: Pair = Field(description="Its true velocity at the start, [x, y] in m/s.")
    acceleration_std_m_s2: Deviation = Field(
        default=Target.acceleration_std_m_s2,
        description="Deviation of its white acceleration along an axis, in m/s^2.",
    )
    position_std_m: float = Field(
        default=Target.position_std_m,
        ge=LEAST_STD,
        le=1e6,
        description="Deviation of its first estimated position, in m.",
    )
    velocity_std_m_s: float = Field(
        default=Target.velocity_std_m_s,
        ge=LEAST_STD,
        le=1e6,
        description="Deviation of its first estimated velocity, in m/s.",
    )

    @property
    def target(self) -> Target:
        """The plain target."""
        return Target(**self.model_dump())
