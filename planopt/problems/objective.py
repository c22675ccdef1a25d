"""Objective of a problem, a goal or a weighted sum of terms, and the constraints on every plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property, lru_cache
from typing import Annotated, Any, ClassVar, Literal, Union

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PydanticUserError,
    Strict,
    TypeAdapter,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from planopt.errors import InputError
from planopt.keys import Part, ReadAs, Table, ValidatedAs, fault_of, made_of, saved, table_of
from planopt.objectives.terms.term import Term, registered_terms
from planopt.parts import Registry, calling, class_name, is_own, part_of


class AnyTerm:
    """Schema marker that accepts a term's table of any registered kind."""

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
        """Return the JSON schema of a term's table, one alternative for each registered kind."""
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
    choice: Any = Union[_tables_of(terms)]  # noqa: UP007
    tagged: Any = Annotated[choice, Field(discriminator="kind")]
    return TypeAdapter[Any](tagged)


@lru_cache(maxsize=4)
def _tables_of(terms: tuple[type[Term], ...]) -> tuple[type[BaseModel], ...]:
    found: list[type[BaseModel]] = []
    for term in terms:
        try:
            found.append(table_of(term))
        except (PydanticUserError, NameError, TypeError) as error:
            if not is_own(term):
                raise
            raise InputError(
                f"the fields of the term {class_name(term)} cannot be saved as keys: {error}",
                key="objective.terms",
                remedy="annotate each field as a number, text, or a tuple of these",
            ) from error
    return tuple(found)


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
    task: ClassVar[str] = "reach"
    has_goal: ClassVar[bool] = True
    sense: ClassVar[Literal["min", "max"]] = "min"
    terms: ClassVar[tuple[Term, ...]] = ()

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

    has_goal: ClassVar[bool] = False
    sense: ClassVar[Literal["min", "max"]] = "max"
    cost_to_go: ClassVar[None] = None

    terms: tuple[Term, ...]  # At least one; the first determines the task

    @property
    def task(self) -> str:
        """Return the task of the first term."""
        return self.terms[0].task or "custom"

    def __post_init__(self) -> None:
        if not self.terms:
            raise InputError("is empty", key="objective.terms", remedy="give at least one term")

    def at_horizon(self, steps: int) -> TermsObjective:
        """Return the objective for plans of `steps` steps."""
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


def objective_keys(objective: ReachObjective | TermsObjective) -> dict[str, Any]:
    """Return the table of an objective."""
    if isinstance(objective, ReachObjective):
        return objective.to_keys()
    tables = [(term, {"kind": term.kind, **asdict(term)}) for term in objective.terms]
    return {
        "terms": [
            saved({key: value for key, value in table.items() if key not in term.left_out})
            for term, table in tables
        ]
    }


OBJECTIVE = ReadAs(
    table_of(ReachObjective),
    _objective_of,
    *(ReachObjective, TermsObjective),
    to_keys=objective_keys,
)


_RULES = "planopt.planning.proof.connectivity_rules"

OWN = {
    "each_step": f"{_RULES}:EachStep",
    "average": f"{_RULES}:Average",
    "joint": f"{_RULES}:Joint",
    "outage": f"{_RULES}:Outage",
    "data": f"{_RULES}:Data",
}
"""Import paths of the built-in rules, imported on demand."""

RULES = Registry("a rule", "constraints.connectivity", OWN)


ParameterUncertainty = Literal["path_loss", "all"]
Positive = Annotated[float, Field(gt=0, le=1e9)]


def _known_rule(name: Any) -> str:
    """Return the current name of a rule; stated_times is an old name of each_step with times."""
    try:
        return RULES.find("each_step" if name == "stated_times" else name).kind
    except InputError as error:
        raise PydanticCustomError(
            "rule_name", "should be {remedy}", {"remedy": str(error.remedy).removeprefix("use ")}
        ) from None


def _named(settings: Any) -> dict[str, Any]:
    """Return settings as a dictionary, from a table or from pairs of name and value."""
    try:
        return dict(settings)
    except (TypeError, ValueError):
        raise PydanticCustomError(
            "settings", 'should be a table of values by name, such as {"steps": 3}'
        ) from None


@dataclass(frozen=True)
class ConnectivityRule(Part):
    """Connectivity rule along a path; each step is evaluated at its end position.

    Raises
    ------
    InputError
        The rule does not exist, or `settings` do not belong to it.
    """

    at = "constraints"

    connectivity: Annotated[str, BeforeValidator(_known_rule), Field(examples=list(OWN))] = (
        "each_step"
    )
    """Event that p_min applies to: each_step, average, joint (all steps of a plan), outage (runs of
    steps below p_min), data (delivery; p_min 0: in expectation), or a registered rule."""
    connected_times_s: Annotated[
        tuple[Positive, ...], Strict(False), Field(max_length=100_000)
    ] = ()
    """For each_step: the only times that count, in seconds from the start of the run, multiples of
    planner.step_s."""
    outage_max_m: Annotated[float | None, Field(ge=0, le=1e9)] = None
    """For outage: longest distance in metres of consecutive steps below p_min."""
    outage_max_s: Annotated[float | None, Field(ge=0, le=1e9)] = None
    """For outage: longest duration in seconds of consecutive steps below p_min."""
    data_mbit: Positive | None = None
    """For data: required amount of delivered data in Mbit."""
    deadline_s: Positive | None = None
    """For data: deadline in seconds from the start of the run."""
    rate_mbit_s: Positive | None = None
    """For data: rate of the link while connected, in Mbit/s."""
    slack_max_db: Annotated[float | None, Field(ge=0, le=500)] = None
    """Maximum shortfall of the chance constraint in dB; 0 makes it hard. By default, each_step may
    be violated if no reachable position satisfies it."""
    slack_price: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    """Price of one dB of slack in units of the objective; requires slack_max_db."""
    parameter_uncertainty: ParameterUncertainty = "path_loss"
    """Parameters treated as uncertain in p_min: path_loss, or all (path loss, xi, beta and omega;
    only with each_step)."""
    settings: Annotated[
        Mapping[str, float] | tuple[tuple[str, float], ...],
        ValidatedAs(dict[str, float]),
        Field(max_length=100),
        BeforeValidator(_named),
        AfterValidator(lambda settings: tuple(sorted(settings.items()))),
    ] = ()
    """Field values of a registered rule by name."""

    def fault(self) -> str | None:
        """Return None if the settings fit the rule; raise an `InputError` otherwise."""
        settings = dict(self.settings)
        if settings or self.connectivity not in OWN:
            with calling(self.kind, "__post_init__", key="constraints.settings"):
                try:
                    if self.connectivity in OWN:
                        raise TypeError(f"it has no field {min(settings)}")
                    self.kind(**settings)
                except InputError as error:
                    raise InputError(
                        f"are not accepted by the rule: {error.message}",
                        key="constraints.settings",
                        remedy=error.remedy or "correct the values",
                    ) from error
                except TypeError as error:
                    raise InputError(
                        f"do not match the fields of the rule {self.connectivity!r}: {error}",
                        key="constraints.settings",
                        remedy="give one number for each field of the rule, and no others",
                    ) from error
        return None

    @property
    def kind(self) -> type[Any]:
        """Return the class of the rule."""
        return RULES.find(self.connectivity)

    @property
    def by_step(self) -> bool:
        """Return True if the rule constrains steps individually."""
        return self.kind.by_step

    @property
    def every_step(self) -> bool:
        """Return True if p_min applies to every step individually."""
        return self.by_step and not self.connected_times_s

    @property
    def is_plain(self) -> bool:
        """Return True if p_min applies to each step where feasible, without a limit on slack."""
        return self.every_step and self.slack_max_db is None


@dataclass(frozen=True, kw_only=True)
class Constraints(Part):
    """Constraints on every plan."""

    at = "constraints"
    Keys = table_of(ConnectivityRule)
    not_keys = frozenset({"rule"})

    p_min: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Required probability of connection at every step where feasible, or of the event selected by
    connectivity; 0 if no connection is required. The task "reach" needs a value above 0."""
    clearance_m: Annotated[float, Field(ge=0, le=1e4)] = 1.0
    """Minimum distance in metres of the swept path from static and moving obstacles."""
    goal_radius_m: Annotated[float, Field(gt=0, le=1e4)] = 1.0
    """Distance in metres at which a goal counts as reached."""
    separation_m: Annotated[float, Field(ge=0, le=1e4)] = 0.0
    """Minimum distance in metres between any two robots at equal times; 0 for none."""
    rule: ConnectivityRule = field(default_factory=ConnectivityRule)
    """Event that p_min applies to; default: the connection at each step."""

    def __post_init__(self) -> None:
        remedy = 'give ConnectivityRule("joint"), or of another name'
        part_of("constraints.rule", self.rule, ConnectivityRule, remedy)
        super().__post_init__()

    def to_keys(self) -> dict[str, Any]:
        """Return the keys of the table, including the non-default keys of the rule."""
        default = ConnectivityRule().to_keys()
        rule = {key: value for key, value in self.rule.to_keys().items() if value != default[key]}
        if self.rule.settings:
            rule["settings"] = dict(self.rule.settings)
        return {**super().to_keys(), **rule}

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return the fields, including the rule."""
        return {**super().of_keys(table), "rule": ConnectivityRule.of_table(table)}

    def fault(self) -> str | None:
        """Return a message if a value does not fit the connectivity rule."""
        rule, form = self.rule, self.rule.connectivity
        given = [key for key, value in rule.to_keys().items() if value not in (None, ())]
        for other in map(RULES.find, OWN):
            for key in other.keys:
                if other.kind != form and key in given:
                    return (
                        f'has {key}, which applies only with connectivity = "{other.kind}": '
                        "leave it out, or set this connectivity"
                    )
        if not self.requires_connection and not rule.every_step:
            return (
                f'needs p_min above 0 for connectivity = "{form}": write p_min = 0.9, for instance'
            )
        missing = rule.kind.keys_fault(given)
        if missing is not None:
            return f"needs {missing}, for instance"
        if self.rule.slack_max_db is not None and not self.requires_connection:
            return (
                "has slack_max_db, but no connection is required, since p_min is 0: write "
                "a p_min above 0, or leave slack_max_db out"
            )
        if self.rule.slack_price > 0.0 and not self.rule.slack_max_db:
            return "has slack_price, which needs slack_max_db above 0: write slack_max_db = 3.0"
        if self.rule.parameter_uncertainty != "all":
            return None
        if not self.rule.by_step:
            return (
                'has parameter_uncertainty = "all", which does not support connectivity = '
                f'"{self.rule.connectivity}": leave it out, or write connectivity = "each_step"'
            )
        if self.p_min == 0.0:
            return (
                'has parameter_uncertainty = "all", but p_min is 0: write a p_min above 0, or '
                "leave parameter_uncertainty out"
            )
        return None

    @property
    def requires_connection(self) -> bool:
        """Return True if the connection is constrained."""
        return self.p_min > 0.0 or not self.rule.kind.uses_p_min

    @property
    def step_p_min(self) -> float:
        """Return the required probability of single steps; 0 if p_min applies to another event."""
        return self.p_min if self.rule.kind.holds_steps else 0.0
