"""Base class of objective terms, and the registry of all kinds."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

import planopt.objectives.terms as own_terms
from planopt.arrays import Floats, Indices
from planopt.errors import InputError, listed
from planopt.parts import class_name, require_name
from planopt.targets.information_filter import Sensor

if TYPE_CHECKING:
    from planopt.objectives.moments import Pull
    from planopt.objectives.terms.context import NearPath, Nodes, Part, Paths, TermContext
    from planopt.objectives.upper_bounds import StageBounds

Weight = Annotated[
    float,
    Field(default=1.0, ge=0, le=1e9, description="Weight in the sum of terms.", title="Weight"),
]

Structure = Literal["stagewise", "chain", "full"]
"""Sparsity of a term's Hessian: blocks per stage, between successive stages as well, or dense."""
Steers = Literal["variance", "connection", "goal"]
"""Position that a robot is steered to: largest variance, probed for connection, or the goal."""


@dataclass(frozen=True)
class TermSetting:
    """Properties of a problem that decide whether it supports a term."""

    horizon: int  # N, the number of steps of a plan
    stations: int  # Number of base stations
    has_target: bool  # Whether there is a target
    has_dynamics: bool = False  # Whether any robot has dynamics (inertia or a heading)
    is_free: bool = False  # True if there are no other terms and no chance constraint
    has_estimates: bool = False  # Whether packets contain target estimates


@dataclass(frozen=True)
class Term:
    """Summand of an objective to be maximised.

    Attributes
    ----------
    weight
        Factor of the term in the sum.
    """

    weight: Weight = field(default=1.0, kw_only=True)

    kind: ClassVar[str]
    """Name of the term in problem files."""
    summary: ClassVar[str] = "User-defined term."
    """One-sentence description in the schema."""
    task: ClassVar[str | None] = "custom"
    """Task of a problem whose first term has this kind; None if the kind implies no task."""

    def __init_subclass__(cls) -> None:
        """Register a subclass that defines a kind."""
        super().__init_subclass__()
        if "kind" in cls.__dict__:
            register(cls)

    def at_horizon(self, steps: int) -> Term:
        """Return the term adapted to plans of `steps` steps."""
        return self

    @classmethod
    def table_fault(cls, given: frozenset[str], term: Term) -> str | None:
        """Return text on a conflict of the keys `given` with others; None without conflict."""
        return None

    @property
    def left_out(self) -> frozenset[str]:
        """Return the fields to omit from a saved table."""
        return frozenset()

    def planned(self, setting: TermSetting) -> Term:
        """Return the term with automatic choices resolved for a problem with this `setting`."""
        return self

    @property
    def structure(self) -> Structure:
        """Return the sparsity of the Hessian w.r.t. the positions of a path."""
        return "full"

    @property
    def probes_end(self) -> bool:
        """Return whether the term probes the end of a path and thus defines :meth:`probe_values`.

        Values with a probe are not smooth functions of the path's end.
        """
        return False

    @property
    def is_measured(self) -> bool:
        """Return whether the value is a gain by measurements along the path."""
        return False

    @property
    def averages_map(self) -> bool:
        """Return whether the value is an average over the workspace."""
        return False

    @property
    def variance_threshold(self) -> float | None:
        """Return the variance in dB^2 up to which a position is known; None without a threshold."""
        return None

    @property
    def sensor(self) -> Sensor | None:
        """Return the sensor that tracks the target; None for terms without a target."""
        return None

    @property
    def steers(self) -> Steers | None:
        """Return the kind of steering point chosen before planning; None without steering."""
        return None

    def check(self, setting: TermSetting) -> None:
        """Raise an error if the problem does not support the term.

        Raises
        ------
        InputError
            The key names the invalid field.
        """

    def _without(self, method: str) -> InputError:
        """Return the InputError for a class that lacks `method`."""
        return InputError(
            f"{class_name(self)} does not define the method {method}",
            remedy="define it, or derive the class from planopt.extend.OwnTerm and define "
            "expression",
        )

    def value(self, at: TermContext, path_m: Floats) -> float:
        """Return the term's value of one path (N, 2), from all measurements, as reported."""
        raise self._without("value")

    def values(self, paths: Paths) -> Floats:
        """Return approximate values ``(c,)`` of c paths, for ranking in searches."""
        raise self._without("values")

    def probe_values(self, at: TermContext, paths_m: Floats, chance: Floats) -> Floats:
        """Return the values ``(c,)`` of paths (c, N, 2) for approximate P(connected) (c, N).

        Searches use these values to rank hundreds of paths if the term probes path ends.
        """
        raise self._without("probe_values")

    def derivatives(self, path: NearPath) -> Part:
        """Return the term's value of one path with derivatives, for solvers."""
        raise self._without("derivatives")

    def slope(self, paths: Paths, number: int) -> Pull:
        """Return the adjoints of :meth:`values` w.r.t. the moments of station `number`.

        Terms that are not sums over stations are called for the first station only.
        """
        raise self._without("slope")

    def node_reward(self, at: TermContext, nodes: Nodes) -> Floats | None:
        """Return the reward of ending a step at each node, for any stage as an array (ny, nx).

        The lattice search maximises these rewards in place of the value. They are exact for terms
        that are sums over steps; for other terms the resulting path is only an initial guess.
        """
        return None

    def stage_reward(
        self, at: TermContext, places_m: Floats, stage: int | Indices, chance: Floats
    ) -> Floats | None:
        """Return the reward of ending step `stage` (from 0) at positions (..., 2)."""
        return None

    def largest_stage_reward(self, at: TermContext) -> float:
        """Return an upper bound of :meth:`stage_reward`."""
        return 0.0

    def stage_bounds(self, at: TermContext) -> StageBounds | str:
        """Return upper bounds of the term's stage rewards, or the reason why there are none."""
        return "without a proven bound"

    def move_reward(self, lengths_m: Floats, step_s: float) -> Floats:
        """Return the rewards of moves of these lengths, independent of position."""
        return np.zeros(len(lengths_m))


_kinds: dict[str, type[Term]] = {}


def register(term: type[Term]) -> None:
    """Register a term class by its kind, for problem files."""
    kind = require_name(term.kind, f"the term {class_name(term)}")
    known = _kinds.get(kind)
    if known is not None and class_name(known) != class_name(term):
        raise InputError(
            f"the kind {kind!r} of {class_name(term)} is already used by {class_name(known)}",
            remedy="choose another kind",
        )
    _kinds[kind] = term


def require_kind(term: Term, key: str) -> None:
    """Raise an InputError for a term whose class cannot be saved in a problem file."""
    made = type(term)
    if not hasattr(made, "kind"):
        raise InputError(
            f"the class {class_name(made)} has no attribute kind",
            key=key,
            remedy='add kind: ClassVar[str] = "...", the name of the term in problem files',
        )
    known = {each.name for each in fields(term)} | {*inspect.get_annotations(Term)}
    stray = [name for name in inspect.get_annotations(made) if name not in known]
    if (stray or "__init__" in vars(made)) and "__dataclass_params__" not in vars(made):
        raise InputError(
            f"the class {class_name(made)} is not a dataclass: {listed(stray or ['__init__'])} "
            "would not be saved",
            key=key,
            remedy="write @dataclass(frozen=True) above the class",
        )


def registered_terms() -> tuple[type[Term], ...]:
    """Return all registered term classes, sorted by kind."""
    for module in pkgutil.iter_modules(own_terms.__path__):
        importlib.import_module(f"{own_terms.__name__}.{module.name}")
    return tuple(_kinds[kind] for kind in sorted(_kinds))


def outside_terms() -> tuple[type[Term], ...]:
    """Return the registered term classes from outside planopt, for worker processes."""
    home = f"{own_terms.__name__}."
    return tuple(term for term in registered_terms() if not term.__module__.startswith(home))


def explores(term: Term) -> bool:
    """Return whether a term guides a robot to unmeasured positions."""
    return term.is_measured or term.steers == "variance"
