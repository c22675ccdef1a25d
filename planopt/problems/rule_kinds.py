"""The rules of connectivity that a problem may name: those of planopt, and those of programs.

A rule has two halves that share no code: what it means, by which plans are judged
(:class:`planopt.planning.proof.rules.proven.ProvenRule`), and how plans are sought that keep it
(:class:`planopt.planning.worth.rules.planned.PlannedRule`).
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any, cast

from planopt.errors import InputError, listed
from planopt.parts import require_name

_PROVEN = "planopt.planning.proof.rules.proven"
_PLANNED = "planopt.planning.worth.rules"


@dataclass(frozen=True)
class RuleKind:
    """A rule of connectivity that problems may name.

    Attributes
    ----------
    name
        Value of the key ``constraints.connectivity``.
    proven, planned
        Classes of its halves, or where they are: ``module:name``, imported when they are needed.
    keys
        Keys of ``[constraints]`` that belong to this rule alone.
    of_steps
        Whether p_min is the probability of single steps.
    by_step
        Whether single steps are asked for, each by itself.
    greatest
        Whether the bound is a greatest value.
    asks_without_p_min
        Whether something is asked of the connection where p_min is 0.
    """

    name: str
    proven: type | str
    planned: type | str
    keys: tuple[str, ...] = ()
    of_steps: bool = False
    by_step: bool = False
    greatest: bool = False
    asks_without_p_min: bool = False

    def half(self, planned: bool) -> Any:
        """Return the class of the half that plans, or of the one that judges."""
        found = self.planned if planned else self.proven
        if not isinstance(found, str):
            return found
        module, _, name = found.partition(":")
        return getattr(import_module(module), name)


OWN = {
    kind.name: kind
    for kind in (
        RuleKind(
            "each_step",
            f"{_PROVEN}:EachStep",
            f"{_PLANNED}.steps:PlannedSteps",
            of_steps=True,
            by_step=True,
        ),
        RuleKind(
            "stated_times",
            f"{_PROVEN}:StatedTimes",
            f"{_PLANNED}.steps:PlannedSteps",
            ("connected_times_s",),
            of_steps=True,
            by_step=True,
        ),
        RuleKind("average", f"{_PROVEN}:Average", f"{_PLANNED}.sums:PlannedAverage"),
        RuleKind("joint", f"{_PROVEN}:Joint", f"{_PLANNED}.joint:PlannedJoint"),
        RuleKind(
            "outage",
            f"{_PROVEN}:Outage",
            f"{_PLANNED}.outage:PlannedOutage",
            ("outage_max_m", "outage_max_s"),
            of_steps=True,
            greatest=True,
        ),
        RuleKind(
            "data",
            f"{_PROVEN}:Data",
            f"{_PLANNED}.sums:PlannedData",
            ("data_mbit", "deadline_s", "rate_mbit_s"),
            asks_without_p_min=True,
        ),
    )
}
"""planopt's own."""

_registered: dict[str, RuleKind] = {}


def register_rule(rule: type[Any]) -> None:
    """Let problems name a rule of connectivity of one's own.

    Parameters
    ----------
    rule
        A :class:`planopt.planning.proof.rules.own.OwnRule`, which does this by itself; one that was
        registered under its name before is replaced.

    Raises
    ------
    InputError
        Its ``kind`` is no word, or that of one of planopt's rules.
    """
    name = require_name(getattr(rule, "kind", ""), "a rule", OWN)
    _registered[name] = RuleKind(
        name, rule, f"{_PLANNED}.sums:PlannedOwn", asks_without_p_min=not rule.asks_p_min
    )


def registered_rules() -> tuple[type[Any], ...]:
    """Return what :func:`register_rule` was given, for worker processes."""
    return tuple(kind.half(planned=False) for kind in _registered.values())


def rule_kind(name: str) -> RuleKind:
    """Return the rule of a name.

    Raises
    ------
    InputError
        There is none.
    """
    found = (
        (OWN.get(name) or _registered.get(name)) if isinstance(cast("object", name), str) else None
    )
    if found is None:
        raise InputError(
            f"is {name!r}",
            key="constraints.connectivity",
            remedy=f"use one of {listed([*OWN, *_registered])}",
        )
    return found


def known_rule(name: str) -> str:
    """Return the name of a rule, for the fields of tables.

    Raises
    ------
    ValueError
        There is no such rule.
    """
    try:
        return rule_kind(name).name
    except InputError as error:
        raise ValueError(f"{error.message}: {error.remedy}") from None
