"""The table ``[objective]`` of a problem file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from planopt.problems.problem import CostToGo, OutageCharge, ReachObjective, Term
from planopt.problems.tables import Table
from planopt.problems.term_tables import ANY_TERM


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
        description="A metre driven where the probability of connection is P counts "
        "1 + outage_price (1 - P) metres (a number). constraints.slack_max_db = 0 forbids holes.",
    )
    outage_charge: OutageCharge = Field(
        default=ReachObjective.outage_charge,
        description="Where outage_price is charged: everywhere, so that plans have the least "
        "expected cost, or below_p_min, so that places that keep p_min cost nothing.",
    )
    terms: list[Annotated[Term, ANY_TERM]] = Field(
        default=[],
        description="For tasks other than reach: the weighted sum to be maximised; the first term "
        "is the task's.",
    )
