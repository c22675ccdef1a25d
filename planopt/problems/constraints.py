"""The constraints on every plan of a problem: clearance, and a rule of connectivity.

Rules are those of planopt, and those of programs, each one class
(:class:`planopt.planning.proof.rules.rule.Rule`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal, cast

from planopt.errors import InputError, listed
from planopt.parts import calling, part_of, require_name
from planopt.plain_values import make_plain

_RULES = "planopt.planning.proof.rules"

OWN = {
    "each_step": f"{_RULES}.each_step:EachStep",
    "average": f"{_RULES}.average:Average",
    "joint": f"{_RULES}.joint:Joint",
    "outage": f"{_RULES}.outage:Outage",
    "data": f"{_RULES}.data:Data",
}
"""Where the classes of planopt's own rules are, imported when they are needed."""

_registered: dict[str, type[Any]] = {}


def register_rule(rule: type[Any]) -> None:
    """Let problems name a rule of connectivity of one's own."""
    _registered[require_name(getattr(rule, "kind", ""), "a rule", OWN)] = rule


def registered_rules() -> tuple[type[Any], ...]:
    """Return what :func:`register_rule` was given, for worker processes."""
    return tuple(_registered.values())


def rule_kind(name: str) -> type[Any]:
    """Return the class of the rule of a name."""
    given = cast("object", name)
    if isinstance(given, str) and given in OWN:
        module, _, found = OWN[given].partition(":")
        return getattr(import_module(module), found)
    if isinstance(given, str) and given in _registered:
        return _registered[given]
    raise InputError(
        f"is {name!r}",
        key="constraints.connectivity",
        remedy=f"use one of {listed([*OWN, *_registered])}",
    )


def known_rule(name: str) -> str:
    """Return the name of a rule, for the fields of tables."""
    try:
        return rule_kind(name).kind
    except InputError as error:
        raise ValueError(f"{error.message}: {error.remedy}") from None


ParameterUncertainty = Literal["path_loss", "all"]


@dataclass(frozen=True)
class ConnectivityRule:
    """The rule of connectivity along a path; a step counts by the place that it ends at.

    Attributes
    ----------
    connectivity
        ``each_step``: probability at least p_min at each step, or at the stated times.
        ``average``: on average over the run so far and the plan. ``joint``: that all steps of the
        plan are connected. ``outage``: steps below p_min in a row are no longer than stated.
        ``data``: the data delivered keep pace with the deadline, with probability p_min or, where
        that is 0, in expectation. Or the kind of a rule of one's own (`planopt.extend.OwnRule`).
    connected_times_s
        Of ``each_step``: the only times that count, from the start of the run; empty for all steps.
    outage_max_m, outage_max_s
        Of ``outage``, one of them.
    data_mbit, deadline_s, rate_mbit_s
        Of ``data``: how much, until when, and the rate while connected.
    slack_max_db
        The rule may be missed by so many dB: it must hold were the threshold that much lower. 0 is
        hard. None: ``each_step`` may be missed where no place within reach keeps it, others are
        hard.
    slack_price
        What a dB of slack costs, in the objective's unit.
    parameter_uncertainty
        ``path_loss``: predictions count that theta is estimated; ``all``: that xi, beta and omega
        are as well.
    settings
        Values of the fields of a rule of one's own, by name.

    Raises
    ------
    InputError
        There is no such rule, or `settings` are not its own.
    """

    connectivity: str = "each_step"
    connected_times_s: tuple[float, ...] = ()
    outage_max_m: float | None = None
    outage_max_s: float | None = None
    data_mbit: float | None = None
    deadline_s: float | None = None
    rate_mbit_s: float | None = None
    slack_max_db: float | None = None
    slack_price: float = 0.0
    parameter_uncertainty: ParameterUncertainty = "path_loss"
    settings: Mapping[str, float] | tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        try:
            settings = sorted(dict(self.settings).items())
        except (TypeError, ValueError):
            raise InputError(
                f"is {self.settings!r}",
                key="constraints.settings",
                remedy='give values by name, such as {"steps": 3}',
            ) from None
        object.__setattr__(self, "settings", tuple(settings))
        make_plain(self)
        rule = self.kind
        if settings or self.connectivity not in OWN:
            with calling(rule, "__post_init__", key="constraints.settings"):
                try:
                    if self.connectivity in OWN:
                        raise TypeError(f"it has no {settings[0][0]}")
                    rule(**dict(settings))
                except TypeError as error:
                    raise InputError(
                        f"do not fit {self.connectivity}: {error}",
                        key="constraints.settings",
                        remedy="give a number for each field of the rule, a frozen dataclass, and "
                        "no others",
                    ) from error

    @property
    def kind(self) -> type[Any]:
        """The class of the rule."""
        return rule_kind(self.connectivity)

    @property
    def by_step(self) -> bool:
        """Return whether single steps are judged, each by itself."""
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
class Constraints:
    """The constraints on every plan.

    Attributes
    ----------
    p_min
        Least probability of connection, of what `rule` says; 0 asks for none.
    clearance_m
        Least distance of the whole swept path from every obstacle, and from every moving one.
    goal_radius_m
        The goal is reached within this distance of it.
    separation_m
        Least distance of any two robots at equal times, all the way; 0 asks for none.
    rule
        Where, when or over what the connection is asked for; at each step unless it says else.
    """

    p_min: float = 0.0
    clearance_m: float = 1.0
    goal_radius_m: float = 1.0
    separation_m: float = 0.0
    rule: ConnectivityRule = field(default_factory=ConnectivityRule)

    def __post_init__(self) -> None:
        make_plain(self)
        remedy = 'give ConnectivityRule("joint"), or of another name'
        part_of("constraints.rule", self.rule, ConnectivityRule, remedy)

    @property
    def asks_connection(self) -> bool:
        """Return whether anything is asked of the connection."""
        return self.p_min > 0.0 or not self.rule.kind.asks_p_min

    @property
    def step_p_min(self) -> float:
        """Return the probability asked of single steps; 0 where p_min is of something else."""
        return self.p_min if self.rule.kind.holds_steps else 0.0
