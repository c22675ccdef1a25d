"""The base class of a term of the objective, and the registry of all kinds.

A term is a frozen dataclass whose fields are the keys of its table in a problem file: types and
ranges stand in their annotations. A subclass with a ``kind`` is registered by being defined, inside
planopt (every module of this package is read) or outside (import it before its problems are read).
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

import planopt.objectives.terms as own_terms
from planopt.errors import InputError, listed
from planopt.parts import class_name, require_name
from planopt.targets.sensor import Sensor

if TYPE_CHECKING:
    from planopt.objectives.moments import Pull
    from planopt.objectives.terms.context import NearPath, Nodes, Part, Paths, TermContext

Weight = Annotated[
    float, Field(default=1.0, ge=0, le=1e9, description="In the sum of terms.", title="Weight")
]

Structure = Literal["stagewise", "chain", "full"]
"""What the Hessian of a value is made of: a 2 x 2 block of each stage; these and one between each
stage and the next; or everything."""

Steers = Literal["variance", "connection", "goal"]
"""What a robot is steered to: the place of largest variance, a place to try for connection, or its
goal."""


@dataclass(frozen=True)
class TermSetting:
    """The parts of a problem that decide whether a term can be planned for in it."""

    horizon: int  # N, the steps of a plan
    stations: int  # How many there are
    has_target: bool  # Whether there is a target
    has_dynamics: bool = False  # Whether a robot has inertia or a heading
    is_free: bool = False  # Whether the term is the only one, and nothing is asked of connectivity
    has_estimates: bool = False  # Whether packets have estimates of a target


@dataclass(frozen=True)
class Term:
    """One summand of an objective that is to be maximised.

    Attributes
    ----------
    weight
        Factor of the term in the sum.
    """

    weight: Weight = field(default=1.0, kw_only=True)

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

    def planned(self, setting: TermSetting) -> Term:
        """Return the term as plans take it in a problem."""
        return self

    @property
    def structure(self) -> Structure:
        """Return how the value of a path couples its places."""
        return "full"

    @property
    def probes_end(self) -> bool:
        """Return whether the end of a path is a place that is tried: :meth:`probe_values` is there.

        Such values are not smooth where paths end.
        """
        return False

    @property
    def is_measured(self) -> bool:
        """Return whether the value is information that measurements along the path give."""
        return False

    @property
    def averages_map(self) -> bool:
        """Return whether the value is an average over the workspace."""
        return False

    @property
    def variance_threshold(self) -> float | None:
        """Stopping condition: variance in dB^2 up to which a place is known; None without one."""
        return None

    @property
    def sensor(self) -> Sensor | None:
        """The sensor that the target is tracked by; None for terms without target."""
        return None

    @property
    def steers(self) -> Steers | None:
        """Return what a robot is steered to before its plan is made; None if nothing steers."""
        return None

    def check(self, setting: TermSetting) -> None:
        """Raise what keeps the term from being planned for.

        Raises
        ------
        InputError
            Its key is the field at fault.
        """

    def _without(self, method: str) -> InputError:
        """Return the error of a class that lacks a method."""
        return InputError(
            f"{class_name(self)} has no method {method}",
            remedy=f"define {method}, or derive the class from planopt.extend.OwnTerm and define "
            "expression",
        )

    def value(self, at: TermContext, path_m: NDArray[np.float64]) -> float:
        """Return the value of one path (N, 2), from all measurements: what is reported."""
        raise self._without("value")

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the values of many paths at once, ``(c,)``: what searches compare."""
        raise self._without("values")

    def probe_values(
        self, at: TermContext, paths_m: NDArray[np.float64], chance: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the values of paths (c, N, 2) by guessed chances of connection (c, N); ``(c,)``.

        Of terms that try places: searches rank hundreds of ways by it.
        """
        raise self._without("probe_values")

    def derivatives(self, path: NearPath) -> Part:
        """Return the value of one path with its derivatives, as a solver asks for it."""
        raise self._without("derivatives")

    def slope(self, paths: Paths, number: int) -> Pull:
        """Return derivatives of :meth:`values` by the moments of one station, given its number.

        Terms that are no sum over stations are only asked for the first.
        """
        raise self._without("slope")

    def node_reward(self, at: TermContext, nodes: Nodes) -> NDArray[np.float64] | None:
        """Return what ending a step at each node is worth by itself, (ny, nx), at any stage.

        Rewards of nodes stand in for the value in the search of the lattice. They are exact for
        terms that add up over steps; for others the path that comes out is only a first guess.
        """
        return None

    def stage_reward(
        self,
        at: TermContext,
        places_m: NDArray[np.float64],
        stage: int | NDArray[np.intp],
        chance: NDArray[np.float64],
    ) -> NDArray[np.float64] | None:
        """Return the reward of ending step `stage`, from 0 on, at places (..., 2)."""
        return None

    def largest_stage_reward(self, at: TermContext) -> float:
        """Return an upper limit of :meth:`stage_reward`."""
        return 0.0

    def move_reward(self, lengths_m: NDArray[np.float64], step_s: float) -> NDArray[np.float64]:
        """Return what moves of these lengths are worth in themselves."""
        return np.zeros(len(lengths_m))


_kinds: dict[str, type[Term]] = {}


def register(term: type[Term]) -> None:
    """Make the kind of a term known to problem files."""
    kind = require_name(term.kind, f"the term {class_name(term)}")
    known = _kinds.get(kind)
    if known is not None and class_name(known) != class_name(term):
        raise InputError(
            f"kind {kind!r} of {class_name(term)} is that of {class_name(known)} already",
            remedy="give the term a kind of its own",
        )
    _kinds[kind] = term


def require_kind(term: Term, key: str) -> None:
    """Refuse a term whose class problem files could not name or fill."""
    made = type(term)
    if not hasattr(made, "kind"):
        raise InputError(
            f"{class_name(made)} has no kind",
            key=key,
            remedy='add kind: ClassVar[str] = "..." to the class: its name in problem files',
        )
    known = {each.name for each in fields(term)} | {*inspect.get_annotations(Term)}
    stray = [name for name in inspect.get_annotations(made) if name not in known]
    if (stray or "__init__" in vars(made)) and "__dataclass_params__" not in vars(made):
        raise InputError(
            f"{class_name(made)} is no dataclass: {listed(stray or ['__init__'])} would not be "
            "saved",
            key=key,
            remedy="write @dataclass(frozen=True) above the class",
        )


def registered_terms() -> tuple[type[Term], ...]:
    """Return every known class of terms, in the order of their kinds."""
    for module in pkgutil.iter_modules(own_terms.__path__):
        importlib.import_module(f"{own_terms.__name__}.{module.name}")
    return tuple(_kinds[kind] for kind in sorted(_kinds))


def outside_terms() -> tuple[type[Term], ...]:
    """Return the known classes of terms that are not planopt's, for worker processes."""
    home = f"{own_terms.__name__}."
    return tuple(term for term in registered_terms() if not term.__module__.startswith(home))
