"""The table ``[constraints]`` of a problem file."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.errors import InputError
from planopt.problems.constraints import (
    OWN,
    ConnectivityRule,
    Constraints,
    ParameterUncertainty,
    known_rule,
    rule_kind,
)
from planopt.problems.tables import Table

Positive = Annotated[float, Field(gt=0, le=1e9)]


def _former_name(name: Any) -> Any:
    """Read the former rule stated_times as each_step with times."""
    return "each_step" if name == "stated_times" else name


class ConstraintsTable(Table):
    """``[constraints]``: what every plan must keep."""

    p_min: float = Field(
        default=Constraints.p_min,
        ge=0,
        lt=1,
        description="Least probability of connection at every step where that is possible, or of "
        "what connectivity says; 0 asks for none. The task reach needs it above 0.",
    )
    clearance_m: float = Field(
        default=Constraints.clearance_m,
        ge=0,
        le=1e4,
        description="Least distance in metres of the swept path from every obstacle, moving ones "
        "included.",
    )
    goal_radius_m: float = Field(
        default=Constraints.goal_radius_m,
        gt=0,
        le=1e4,
        description="Distance in metres at which the goal is reached.",
    )
    separation_m: float = Field(
        default=Constraints.separation_m,
        ge=0,
        le=1e4,
        description="Least distance in metres of any two robots at equal times, all the way; 0 "
        "asks for none.",
    )
    connectivity: Annotated[
        str,
        BeforeValidator(_former_name),
        AfterValidator(known_rule),
        Field(
            examples=list(OWN),
            description="What p_min is asked of: each_step, average, joint (all "
            "steps of a plan), outage (steps below it in a row), data (delivery; 0: in "
            "expectation); or a rule that is registered.",
        ),
    ] = "each_step"
    connected_times_s: list[Positive] = Field(
        default=[],
        max_length=100_000,
        description="For each_step, the only times that count: seconds from the start of the run, "
        "multiples of planner.step_s.",
    )
    outage_max_m: float | None = Field(
        default=None,
        ge=0,
        le=1e9,
        description="For outage: longest way in metres driven in steps below p_min in a row.",
    )
    outage_max_s: float | None = Field(
        default=None,
        ge=0,
        le=1e9,
        description="For outage: longest time in seconds of steps below p_min in a row.",
    )
    data_mbit: Positive | None = Field(
        default=None, description="For data: what must be delivered, in Mbit."
    )
    deadline_s: Positive | None = Field(
        default=None, description="For data: until when, in seconds from the start of the run."
    )
    rate_mbit_s: Positive | None = Field(
        default=None, description="For data: rate of the link while connected, in Mbit/s."
    )
    slack_max_db: float | None = Field(
        default=None,
        ge=0,
        le=500,
        description="What is asked of the connection may be missed by so many dB; 0 makes it hard. "
        "Left out, each_step may be missed where nothing within reach keeps it.",
    )
    slack_price: float = Field(
        default=0.0,
        ge=0,
        le=1e9,
        description="What a dB of slack costs, in the objective's unit; needs slack_max_db.",
    )

    parameter_uncertainty: ParameterUncertainty = Field(
        default="path_loss",
        description="What p_min counts as estimated: path_loss, or all, xi, beta and omega "
        "besides. all goes with each_step.",
    )
    settings: dict[str, float] = Field(
        default={},
        max_length=100,
        description="Values of the fields of a rule that is registered, by name.",
    )

    @model_validator(mode="after")
    def _keys_of_the_form(self) -> ConstraintsTable:
        fault = self._fault()
        if fault is not None:
            raise PydanticCustomError("one_of", "{words}", {"words": fault})
        try:
            ConnectivityRule(self.connectivity, settings=self.settings)
        except InputError as error:
            # A remedy of its own: the message may have colons, at which others are split.
            words = f"has settings that cannot be used: {error.message}"
            remedy = error.remedy or "give values that the rule accepts"
            context = {"words": words, "remedy": remedy}
            raise PydanticCustomError("one_of", "{words}", context) from error
        return self

    def _fault(self) -> str | None:
        """Return which key does not fit the rule of connectivity."""
        form, given = self.connectivity, self.model_fields_set
        for other in map(rule_kind, OWN):
            for key in other.keys:
                if other.kind != form and key in given:
                    return (
                        f'has {key}, which goes only with connectivity = "{other.kind}": leave it '
                        "out, or write that connectivity"
                    )
        kind = rule_kind(form)
        asks = self.p_min > 0.0 or not kind.asks_p_min
        if not asks and (form != "each_step" or self.connected_times_s):
            return (
                f'needs p_min above 0 for connectivity = "{form}": write p_min = 0.9, for instance'
            )
        if form == "outage" and (self.outage_max_m is None) == (self.outage_max_s is None):
            return (
                'needs one of outage_max_m and outage_max_s for connectivity = "outage": write '
                "outage_max_s = 10.0, for instance"
            )
        if form == "data":
            for key in kind.keys:
                if not getattr(self, key):
                    return (
                        f'needs {key} for connectivity = "{form}": write {key} = 100.0, for '
                        "instance"
                    )
        if self.slack_max_db is not None and not asks:
            return (
                "has slack_max_db, but nothing is asked of the connection, since p_min is 0: write "
                "a p_min above 0, or leave slack_max_db out"
            )
        if self.parameter_uncertainty == "all" and not kind.by_step:
            return (
                f'has parameter_uncertainty = "all", not for connectivity = "{form}": leave it '
                "out, or write each_step"
            )
        if self.parameter_uncertainty == "all" and self.p_min == 0.0:
            return (
                'has parameter_uncertainty = "all", but p_min is 0: write a p_min above 0, or '
                "leave parameter_uncertainty out"
            )
        if self.slack_price > 0.0 and not self.slack_max_db:
            return "has slack_price, which needs slack_max_db above 0: write slack_max_db = 3.0"
        return None

    @property
    def constraints(self) -> Constraints:
        """The plain constraints."""
        return Constraints(
            p_min=self.p_min,
            clearance_m=self.clearance_m,
            goal_radius_m=self.goal_radius_m,
            separation_m=self.separation_m,
            rule=ConnectivityRule(
                self.connectivity,
                tuple(self.connected_times_s),
                self.outage_max_m,
                self.outage_max_s,
                self.data_mbit,
                self.deadline_s,
                self.rate_mbit_s,
                self.slack_max_db,
                self.slack_price,
                self.parameter_uncertainty,
                self.settings,
            ),
        )


def constraints_table(constraints: Constraints) -> dict[str, Any]:
    """The keys of the table that `constraints` are from.

    The rule's keys stand beside the others, those that say no more than their defaults left out.
    """
    default = asdict(ConnectivityRule())
    rule = {key: value for key, value in asdict(constraints.rule).items() if value != default[key]}
    if constraints.rule.connected_times_s:
        rule["connected_times_s"] = list(constraints.rule.connected_times_s)
    if constraints.rule.settings:
        rule["settings"] = dict(constraints.rule.settings)
    own = {key: value for key, value in asdict(constraints).items() if key != "rule"}
    return {**own, **rule}
