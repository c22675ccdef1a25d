"""Objectives of problems: reaching a goal, or a weighted sum of terms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal, Union

from pydantic import (
    BaseModel,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PydanticUserError,
    TypeAdapter,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from planopt.errors import InputError
from planopt.keys import Part, ReadAs, Table, fault_of, made_of, saved, table_of
from planopt.objectives.terms.term import Term, registered_terms
from planopt.parts import class_name, is_own


class AnyTerm:
    """Schema marker for the table of a term of any registered kind."""

    def tables(self) -> Sequence[type[BaseModel]]:
        """Return the table models of all registered kinds of terms."""
        return _tables_of(registered_terms())

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return a schema that reads tables of the kinds registered at validation time."""
        return core_schema.no_info_plain_validator_function(read_term)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the JSON schema of the tables of all registered kinds of terms."""
        return handler(_adapter_of(registered_terms()).core_schema)


ANY_TERM = AnyTerm()


def read_term(value: object) -> Term:
    """Return the term that a table describes."""
    table = _adapter_of(registered_terms()).validate_python(value)
    kinds = {term.kind: term for term in registered_terms()}
    chosen = kinds[table.kind]
    term = made_of(chosen, table)
    fault = chosen.table_fault(frozenset(table.model_fields_set), term)
    if fault is not None:
        raise fault_of(fault)
    return term


@lru_cache(maxsize=4)
def _adapter_of(terms: tuple[type[Term], ...]) -> TypeAdapter[Any]:
    choice: Any = Union[_tables_of(terms)]  # pyright: ignore  # noqa: UP007
    tagged: Any = Annotated[choice, Field(discriminator="kind")]  # pyright: ignore
    return TypeAdapter[Any](tagged)


@lru_cache(maxsize=4)
def _tables_of(terms: tuple[type[Term], ...]) -> tuple[type[BaseModel], ...]:
    return tuple(_table_of(term) for term in terms)


def _table_of(term: type[Term]) -> type[BaseModel]:
    try:
        return table_of(term)
    except (PydanticUserError, NameError, TypeError) as error:
        if not is_own(term):
            raise
        raise InputError(
            f"the fields of the term {class_name(term)} cannot be saved as keys: {error}",
            key="objective.terms",
            remedy="annotate each field as a number, text, or a tuple of these",
        ) from error


CostToGo = Literal["geodesic", "connected"]
OutageCharge = Literal["below_p_min", "everywhere"]


class TermsKeys(Table):
    """Key of ``[objective]`` for tasks other than reach."""

    terms: tuple[Annotated[Term, ANY_TERM], ...] = Field(default=(), strict=False)
    """Terms of the weighted sum to maximise (not for task reach); the first sets the task."""


@dataclass(frozen=True)
class ReachObjective(Part):
    """Objective to reach the goal with minimum time, effort and outage.

    The cost in seconds is the integral of ``1 + effort_weight * speed**2`` until arrival. A metre
    driven with connection probability P counts as ``1 + outage_price (1 - P)`` metres.
    """

    at = "objective"
    Keys = TermsKeys

    effort_weight_s2_m2: Annotated[float, Field(ge=0, le=1e6)] = 0.1
    """Weight of speed squared in the cost rate 1 + weight * speed^2, in s^2/m^2."""
    cost_to_go: CostToGo = "connected"
    """Cost-to-go beyond the horizon: geodesic (shortest path around the obstacles) or connected
    (cheapest path at the outage price)."""
    outage_price: Annotated[float, Field(ge=0, le=1e6)] = 10.0
    """Price of outage (a number): a metre driven with connection probability P counts as
    1 + outage_price (1 - P) metres. constraints.slack_max_db = 0 forbids coverage holes."""
    outage_charge: OutageCharge = "everywhere"
    """Positions at which outage_price applies: everywhere (minimum expected cost), or below_p_min
    (no cost at positions that satisfy p_min)."""

    @cached_property
    def charges_everywhere(self) -> bool:
        """Return True if outage_price also applies at positions that satisfy p_min."""
        return self.outage_charge == "everywhere"


@dataclass(frozen=True)
class TermsObjective:
    """Objective to maximise a weighted sum of terms over the horizon."""

    terms: tuple[Term, ...]  # At least one; the first determines the task

    def __post_init__(self) -> None:
        if not self.terms:
            raise InputError("is empty", key="objective.terms", remedy="give at least one term")

    def at_horizon(self, steps: int) -> TermsObjective:
        """Return the objective for plans of another number of steps."""
        return TermsObjective(tuple(term.at_horizon(steps) for term in self.terms))


def _objective_of(table: Any) -> ReachObjective | TermsObjective:
    """Return the objective that a table describes: a sum of terms, or a reach objective."""
    if not table.terms:
        return ReachObjective.of_table(table)
    for key in sorted(table.model_fields_set - {"terms"}):
        raise fault_of(
            f"has {key}, which applies only to the task reach, and terms, which apply to the "
            "other tasks: leave one of them out"
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
