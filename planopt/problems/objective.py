"""The objectives of problems: to reach a goal, or a weighted sum of terms."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from planopt.errors import InputError
from planopt.objectives.terms.term import Term
from planopt.problems.tables import Part, ReadAs, Table, fault_of, saved, table_of
from planopt.problems.term_tables import ANY_TERM

CostToGo = Literal["geodesic", "connected"]
OutageCharge = Literal["below_p_min", "everywhere"]


class TermsKeys(Table):
    """The key of ``[objective]`` for tasks other than reach."""

    terms: tuple[Annotated[Term, ANY_TERM], ...] = Field(default=(), strict=False)
    """For tasks other than reach: the weighted sum to be maximised; the first term is the task's.
    """


@dataclass(frozen=True)
class ReachObjective(Part):
    """Reach the goal in least time and effort, out of contact as little as that is worth.

    The cost is the integral of ``1 + effort_weight * speed**2`` until arrival, in seconds. A metre
    driven where the probability of connection is P counts ``1 + outage_price (1 - P)`` metres.
    """

    at = "objective"
    Keys = TermsKeys

    effort_weight_s2_m2: Annotated[float, Field(ge=0, le=1e6)] = 0.1
    """Weight of speed squared in the cost rate 1 + weight * speed^2, in s^2/m^2."""
    cost_to_go: CostToGo = "connected"
    """Beyond the horizon: geodesic (shortest path round the obstacles) or connected (cheapest path
    at the outage price)."""
    outage_price: Annotated[float, Field(ge=0, le=1e6)] = 10.0
    """A metre driven where the probability of connection is P counts 1 + outage_price (1 - P)
    metres (a number). constraints.slack_max_db = 0 forbids holes."""
    outage_charge: OutageCharge = "everywhere"
    """Where outage_price is charged: everywhere, so that plans have the least expected cost, or
    below_p_min, so that places that keep p_min cost nothing."""

    @property
    def charges_everywhere(self) -> bool:
        """Return whether places that keep p_min are charged, too."""
        return self.outage_charge == "everywhere"


@dataclass(frozen=True)
class TermsObjective:
    """A weighted sum of named terms over the horizon, to be maximised."""

    terms: tuple[Term, ...]  # At least one; the first is the task's

    def __post_init__(self) -> None:
        if not self.terms:
            raise InputError("has no terms", key="objective.terms", remedy="one at least")


def _objective_of(table: Any) -> ReachObjective | TermsObjective:
    """Return the objective that the table describes: its terms, or that of the task reach."""
    if not table.terms:
        return ReachObjective.of_table(table)
    for key in sorted(table.model_fields_set - {"terms"}):
        raise fault_of(
            f"has {key}, which is for task reach, and terms: leave {key} out, or the terms"
        )
    return TermsObjective(tuple(table.terms))


def term_keys(term: Term) -> dict[str, Any]:
    """Return the table of a term."""
    table = {"kind": term.kind, **asdict(term)}
    return saved({key: value for key, value in table.items() if key not in term.left_out})


def _objective_keys(objective: ReachObjective | TermsObjective) -> dict[str, Any]:
    """Return the table of an objective."""
    if isinstance(objective, ReachObjective):
        return objective.to_keys()
    return {"terms": [term_keys(term) for term in objective.terms]}


OBJECTIVE = ReadAs(
    table_of(ReachObjective),
    _objective_of,
    *(ReachObjective, TermsObjective),
    to_keys=_objective_keys,
)
