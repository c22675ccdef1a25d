"""The two forms of an objective: reach a goal, or a weighted sum of terms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from planopt.objectives.terms.term import Term

CostToGo = Literal["geodesic", "connected"]
OutageCharge = Literal["below_p_min", "everywhere"]


@dataclass(frozen=True)
class ReachObjective:
    """Reach the goal in least time and effort, out of contact as little as that is worth.

    The cost is the integral of ``1 + effort_weight * speed**2`` until arrival, in seconds. A metre
    driven where the probability of connection is P counts ``1 + outage_price (1 - P)`` metres.

    Attributes
    ----------
    effort_weight_s2_m2
        Seconds of travel that one second at 1 m/s is worth, in s^2/m^2.
    cost_to_go
        What the way beyond the horizon costs: ``geodesic`` (shortest way round the obstacles) or
        ``connected`` (cheapest path at the outage price).
    outage_price
        What a metre that is certainly out of contact costs besides, in metres (a number).
    outage_charge
        Where that is charged: ``everywhere``, which is the expected cost, or ``below_p_min`` only.
    """

    effort_weight_s2_m2: float = 0.1
    cost_to_go: CostToGo = "connected"
    outage_price: float = 10.0
    outage_charge: OutageCharge = "everywhere"

    @property
    def charges_everywhere(self) -> bool:
        """Return whether places that keep p_min are charged, too."""
        return self.outage_charge == "everywhere"


@dataclass(frozen=True)
class TermsObjective:
    """A weighted sum of named terms over the horizon, to be maximised.

    Attributes
    ----------
    terms
        At least one; the first is the task's.
    """

    terms: tuple[Term, ...]
