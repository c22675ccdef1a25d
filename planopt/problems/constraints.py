"""The constraints on every plan of a problem: clearance, and a rule of connectivity.

Rules are those of planopt, and those of programs, each one class
(:class:`planopt.planning.proof.rule.Rule`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, Strict
from pydantic_core import PydanticCustomError

from planopt.errors import InputError
from planopt.keys import Part, ValidatedAs, table_of
from planopt.parts import Registry, calling, part_of

_RULES = "planopt.planning.proof.connectivity_rules"

OWN = {
    "each_step": f"{_RULES}:EachStep",
    "average": f"{_RULES}:Average",
    "joint": f"{_RULES}:Joint",
    "outage": f"{_RULES}:Outage",
    "data": f"{_RULES}:Data",
}
"""Where the classes of planopt's own rules are, imported when they are needed."""

RULES = Registry("a rule", "constraints.connectivity", OWN)


def register_rule(rule: type[Any]) -> None:
    """Let problems name a rule of connectivity of one's own."""
    RULES.add(getattr(rule, "kind", ""), rule)


def registered_rules() -> tuple[type[Any], ...]:
    """Return what :func:`register_rule` was given, for worker processes."""
    return tuple(RULES.registered.values())


def rule_kind(name: object) -> type[Any]:
    """Return the class of the rule of a name."""
    return RULES.find(name)


ParameterUncertainty = Literal["path_loss", "all"]
Positive = Annotated[float, Field(gt=0, le=1e9)]


def _known_rule(name: Any) -> str:
    """Return the name of a rule; stated_times is the former name of each_step with times."""
    try:
        return rule_kind("each_step" if name == "stated_times" else name).kind
    except InputError as error:
        raise PydanticCustomError(
            "rule_name", "should be {remedy}", {"remedy": str(error.remedy).removeprefix("use ")}
        ) from None


def _named(settings: Any) -> dict[str, Any]:
    """Return settings by name, from a table or from pairs of names and values."""
    try:
        return dict(settings)
    except (TypeError, ValueError):
        raise PydanticCustomError(
            "settings", 'should have values by name, such as {"steps": 3}'
        ) from None


@dataclass(frozen=True)
class ConnectivityRule(Part):
    """The rule of connectivity along a path; a step counts by the place that it ends at.

    Raises
    ------
    InputError
        There is no such rule, or `settings` are not its own.
    """

    at = "constraints"

    connectivity: Annotated[str, BeforeValidator(_known_rule), Field(examples=list(OWN))] = (
        "each_step"
    )
    """The event of p_min: each_step, average, joint (all steps of a plan), outage (steps below
    it in a row), data (delivery; 0: in expectation); or a rule that is registered."""
    connected_times_s: Annotated[
        tuple[Positive, ...], Strict(False), Field(max_length=100_000)
    ] = ()
    """For each_step, the only times that count: seconds from the start of the run, multiples of
    planner.step_s."""
    outage_max_m: Annotated[float | None, Field(ge=0, le=1e9)] = None
    """For outage: longest distance in metres driven in steps below p_min in a row."""
    outage_max_s: Annotated[float | None, Field(ge=0, le=1e9)] = None
    """For outage: longest time in seconds of steps below p_min in a row."""
    data_mbit: Positive | None = None
    """For data: what must be delivered, in Mbit."""
    deadline_s: Positive | None = None
    """For data: until when, in seconds from the start of the run."""
    rate_mbit_s: Positive | None = None
    """For data: rate of the link while connected, in Mbit/s."""
    slack_max_db: Annotated[float | None, Field(ge=0, le=500)] = None
    """The connection may fall short of p_min by so many dB; 0 makes it hard. Left out,
    each_step may be missed where nothing within reach keeps it."""
    slack_price: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    """What a dB of slack costs, in the objective's unit; needs slack_max_db."""
    parameter_uncertainty: ParameterUncertainty = "path_loss"
    """What p_min counts as estimated: path_loss, or all, xi, beta and omega besides. all goes with
    each_step."""
    settings: Annotated[
        Mapping[str, float] | tuple[tuple[str, float], ...],
        ValidatedAs(dict[str, float]),
        Field(max_length=100),
        BeforeValidator(_named),
        AfterValidator(lambda settings: tuple(sorted(settings.items()))),
    ] = ()
    """Values of the fields of a rule that is registered, by name."""

    def fault(self) -> str | None:
        """Refuse settings that do not fit a rule of one's own."""
        settings = dict(self.settings)
        if settings or self.connectivity not in OWN:
            with calling(self.kind, "__post_init__", key="constraints.settings"):
                try:
                    if self.connectivity in OWN:
                        raise TypeError(f"it has no {min(settings)}")
                    self.kind(**settings)
                except InputError as error:
                    raise InputError(
                        f"cannot be used: {error.message}",
                        key="constraints.settings",
                        remedy=error.remedy or "give values that the rule accepts",
                    ) from error
                except TypeError as error:
                    raise InputError(
                        f"do not fit {self.connectivity}: {error}",
                        key="constraints.settings",
                        remedy="give a number for each field of the rule, a frozen dataclass, and "
                        "no others",
                    ) from error
        return None

    @property
    def kind(self) -> type[Any]:
        """Return the class of the rule."""
        return rule_kind(self.connectivity)

    @property
    def by_step(self) -> bool:
        """Return whether the rule holds for single steps, each by itself."""
        return self.kind.by_step

    @property
    def every_step(self) -> bool:
        """Return whether p_min is required of every step by itself."""
        return self.by_step and not self.connected_times_s

    @property
    def is_plain(self) -> bool:
        """Return whether p_min is required of each step where it is possible, and nothing else."""
        return self.every_step and self.slack_max_db is None


@dataclass(frozen=True, kw_only=True)
class Constraints(Part):
    """The constraints on every plan."""

    at = "constraints"
    Keys = table_of(ConnectivityRule)
    not_keys = frozenset({"rule"})

    p_min: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Least probability of connection at every step where that is possible, or of what connectivity
    says; 0 requires none. The task reach needs it above 0."""
    clearance_m: Annotated[float, Field(ge=0, le=1e4)] = 1.0
    """Least distance in metres of the swept path from every obstacle, moving ones included."""
    goal_radius_m: Annotated[float, Field(gt=0, le=1e4)] = 1.0
    """Distance in metres at which the goal is reached."""
    separation_m: Annotated[float, Field(ge=0, le=1e4)] = 0.0
    """Least distance in metres of any two robots at equal times; 0 requires none."""
    rule: ConnectivityRule = field(default_factory=ConnectivityRule)
    """The event that p_min applies to: by default the connection at each step."""

    def __post_init__(self) -> None:
        remedy = 'give ConnectivityRule("joint"), or of another name'
        part_of("constraints.rule", self.rule, ConnectivityRule, remedy)
        super().__post_init__()

    def to_keys(self) -> dict[str, Any]:
        """Return the keys of its table: the rule's stand among them, without its defaults."""
        default = ConnectivityRule().to_keys()
        rule = {key: value for key, value in self.rule.to_keys().items() if value != default[key]}
        if self.rule.settings:
            rule["settings"] = dict(self.rule.settings)
        return {**super().to_keys(), **rule}

    @classmethod
    def of_keys(cls, table: Any) -> dict[str, Any]:
        """Return the fields, the rule among them."""
        return {**super().of_keys(table), "rule": ConnectivityRule.of_table(table)}

    def fault(self) -> str | None:
        """Return which value does not fit the rule of connectivity."""
        rule, form = self.rule, self.rule.connectivity
        given = [key for key, value in rule.to_keys().items() if value not in (None, ())]
        for other in map(rule_kind, OWN):
            for key in other.keys:
                if other.kind != form and key in given:
                    return (
                        f'has {key}, which goes only with connectivity = "{other.kind}": leave it '
                        "out, or write that connectivity"
                    )
        if not self.asks_connection and not rule.every_step:
            return (
                f'needs p_min above 0 for connectivity = "{form}": write p_min = 0.9, for instance'
            )
        missing = rule.kind.keys_fault(given)
        if missing is not None:
            return f"needs {missing}, for instance"
        return self._fault_of_slack() or self._fault_of_uncertainty()

    def _fault_of_slack(self) -> str | None:
        if self.rule.slack_max_db is not None and not self.asks_connection:
            return (
                "has slack_max_db, but nothing is asked of the connection, since p_min is 0: write "
                "a p_min above 0, or leave slack_max_db out"
            )
        if self.rule.slack_price > 0.0 and not self.rule.slack_max_db:
            return "has slack_price, which needs slack_max_db above 0: write slack_max_db = 3.0"
        return None

    def _fault_of_uncertainty(self) -> str | None:
        if self.rule.parameter_uncertainty != "all":
            return None
        if not self.rule.by_step:
            return (
                'has parameter_uncertainty = "all", not for connectivity = '
                f'"{self.rule.connectivity}": leave it out, or write each_step'
            )
        if self.p_min == 0.0:
            return (
                'has parameter_uncertainty = "all", but p_min is 0: write a p_min above 0, or '
                "leave parameter_uncertainty out"
            )
        return None

    @property
    def asks_connection(self) -> bool:
        """Return whether the connection is constrained."""
        return self.p_min > 0.0 or not self.rule.kind.asks_p_min

    @property
    def step_p_min(self) -> float:
        """Return the probability required of single steps; 0 where p_min is of another event."""
        return self.p_min if self.rule.kind.holds_steps else 0.0
