"""The base class of a term of the objective, and the registry of all kinds.

A term is a frozen dataclass whose fields are the keys of its table in a problem file: types and
ranges stand in their annotations. A subclass with a ``kind`` is registered by being defined, inside
planopt (every module of this package is read) or outside (import it before its problems are read).
"""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

import planopt.objectives.terms as own_terms
from planopt.errors import InputError
from planopt.targets.sensor import Sensor

Weight = Annotated[
    float, Field(default=1.0, ge=0, le=1e9, description="In the sum of terms.", title="Weight")
]

Structure = Literal["stagewise", "chain", "full"]
"""What the Hessian of a value is made of: a 2 x 2 block of each stage; these and one between each
stage and the next; or everything."""

Steers = Literal["variance", "connection"]
"""What a robot is steered to: the place of largest variance, or a place to try for connection."""


@dataclass(frozen=True)
class TermSetting:
    """The parts of a problem that decide whether a term can be planned for in it.

    Attributes
    ----------
    horizon
        N, the steps of a plan.
    stations
        How many there are.
    has_target
        Whether there is a target.
    """

    horizon: int
    stations: int
    has_target: bool


@dataclass(frozen=True)
class Term:
    """One summand of an objective that is to be maximised.

    Attributes
    ----------
    weight
        Factor of the term in the sum.
    """

    weight: Weight

    kind: ClassVar[str]
    """Name of the term in problem files."""
    summary: ClassVar[str] = "A term of one's own."
    """One sentence for the description of the schema."""
    task: ClassVar[str | None] = "custom"
    """Task of a problem whose objective begins with this term; None if no task does."""

    def __init_subclass__(cls) -> None:
        """Register a subclass that has a kind."""
        super().__init_subclass__()
        if "kind" in cls.__dict__:
            register(cls)

    @classmethod
    def table_fault(cls, given: frozenset[str], term: Term) -> str | None:
        """Return why the keys `given` in a table do not go with the rest of it, or None."""
        return None

    @property
    def left_out(self) -> frozenset[str]:
        """Fields that a saved table must not have."""
        return frozenset()

    @property
    def structure(self) -> Structure:
        """How the value of a path couples its places."""
        return "full"

    @property
    def needs_power(self) -> bool:
        """Whether the value rests on the predicted power at the end of each step."""
        return False

    @property
    def is_measured(self) -> bool:
        """Whether the value is information that measurements along the path give."""
        return False

    @property
    def learns(self) -> bool:
        """Whether a robot is to go to places that are not known yet."""
        return self.is_measured

    @property
    def is_motion_cost(self) -> bool:
        """Whether the value is only lessened by moving: who has nothing else to do stands."""
        return False

    @property
    def shares_places(self) -> bool:
        """Whether the value of one place is less for another place beside it."""
        return self.is_measured

    @property
    def averages_map(self) -> bool:
        """Whether the value is an average over the workspace."""
        return False

    @property
    def variance_threshold(self) -> float | None:
        """Variance in dB^2 up to which a place counts as known; None without such a threshold."""
        return None

    @property
    def sensor(self) -> Sensor | None:
        """The sensor that the target is tracked by; None for terms without target."""
        return None

    @property
    def tries_connection(self) -> bool:
        """Whether the value depends on where connection was tried before."""
        return False

    @property
    def whole_horizon(self) -> bool:
        """Whether only paths of all steps have a value."""
        return False

    @property
    def steers(self) -> Steers | None:
        """What a robot is steered to before its plan is made; None if nothing steers."""
        return None

    @property
    def calibration_fault(self) -> str | None:
        """Why the term does not go with a calibrated law of connection; None where it does."""
        return None

    def check(self, setting: TermSetting) -> None:
        """Raise what keeps the term from being planned for.

        Raises
        ------
        InputError
            Its key is the field at fault.
        """


_kinds: dict[str, type[Term]] = {}


def register(term: type[Term]) -> None:
    """Make the kind of a term known to problem files.

    Raises
    ------
    InputError
        Another class has this kind.
    """
    known = _kinds.get(term.kind)
    if known is not None and _name(known) != _name(term):
        raise InputError(
            f"kind {term.kind!r} of {_name(term)} is that of {_name(known)} already",
            remedy="give the term a kind of its own",
        )
    _kinds[term.kind] = term


def registered_terms() -> tuple[type[Term], ...]:
    """Return every known class of terms, in the order of their kinds."""
    for module in pkgutil.iter_modules(own_terms.__path__):
        importlib.import_module(f"{own_terms.__name__}.{module.name}")
    return tuple(_kinds[kind] for kind in sorted(_kinds))


def _name(term: type[Term]) -> str:
    return f"{term.__module__}.{term.__qualname__}"
