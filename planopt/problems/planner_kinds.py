"""Registry of planners: built-in planners and registered ones.

A package adds planners by the entry-point group ``planopt.planners``: the entry-point name is that
of the planner, and its object is a :class:`PlannerKind` or a factory. A program calls
:func:`register_planner`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

from planopt.errors import InputError
from planopt.parts import Registry, part_of

GROUP = "planopt.planners"
"""Entry-point group of external planners."""

_HOME = "planopt.planning.planners"
_BOUNDS = "planopt.planning.foresight"


@dataclass(frozen=True)
class PlannerKind:
    """Type of planner that problems can select by name.

    Attributes
    ----------
    name
        Value of the key ``planner.name``.
    make
        Factory, or its import path ``module:name``. It takes the problem of one robot, its geometry
        and a random number generator, and returns an object with the method ``plan`` of
        :class:`planopt.planning.planners.Planner`.
    reaches_goals
        True if the planner supports the task ``reach``. If its path is not verified or does not
        move, planopt's lattice path is released. Robots must be single integrators.
    has_dynamics
        True if the planner supports dynamics other than the single integrator.
    searches
        True if the planner has a global search with a fallback cascade.
    solves
        True if the planner runs a solver; its termination, iterations and residual are reported.
    foresees
        True if the planner knows the ground truth and serves as a performance bound. ``make`` then
        takes the problem of all robots, the first station's ground truth and the target's path, and
        returns the paths of all robots for the whole run.
    tracks
        True if the planner supports only target tracking.
    version
        Version of an external planner; studies do not reuse recorded results of other versions.
    """

    name: str
    make: Callable[..., Any] | str
    reaches_goals: bool = False
    has_dynamics: bool = False
    searches: bool = False
    solves: bool = False
    foresees: bool = False
    tracks: bool = False
    version: str = ""

    def maker(self) -> Callable[..., Any]:
        """Return the factory of the planner.

        Raises
        ------
        InputError
            The factory cannot be imported.
        """
        if not isinstance(self.make, str):
            return self._callable(self.make)
        module, _, attribute = self.make.partition(":")
        try:
            return self._callable(getattr(import_module(module), attribute))
        except (ImportError, AttributeError, ValueError) as error:
            raise InputError(
                f"is {self.name}, but {self.make} cannot be imported: {error}",
                key="planner.name",
                remedy="install the packages that it needs, or choose another planner",
            ) from None

    def _callable(self, make: Any) -> Callable[..., Any]:
        """Return the factory, which must be a class or function."""
        if not callable(make):
            raise InputError(
                f"is of type {type(make).__name__} for {self.name!r}, should be a class or "
                "function",
                key="PlannerKind.make",
                remedy="give the class of the planner (not an instance), or 'module:name'",
            )
        return make


OWN = {
    kind.name: kind
    for kind in (
        *(
            PlannerKind(name, f"{_HOME}:horizon_planner", True, True, True, solves)
            for name, solves in (("auto", True), ("nlp", True), ("scp", True), ("lattice", False))
        ),
        PlannerKind("one_step", f"{_HOME}:OneStepPlanner"),
        PlannerKind("largest_deviation", f"{_HOME}:largest_deviation_planner"),
        PlannerKind("random", f"{_HOME}:RandomPlanner"),
        PlannerKind("random_disk", f"{_HOME}:disk_walk_planner"),
        PlannerKind("random_persistent", f"{_HOME}:persistent_walk_planner"),
        PlannerKind("lawnmower", f"{_HOME}:LawnmowerPlanner"),
        PlannerKind("path_loss_only", f"{_HOME}:path_loss_planner", tracks=True),
        PlannerKind("informed_disk", f"{_HOME}:disk_planner", tracks=True),
        PlannerKind("unaware", f"{_HOME}:unaware_planner", tracks=True),
        PlannerKind("oracle", f"{_BOUNDS}:oracle_paths", foresees=True),
        PlannerKind("oracle_log", f"{_BOUNDS}:oracle_log_paths", foresees=True),
        PlannerKind("clairvoyant", f"{_BOUNDS}:clairvoyant_paths", foresees=True),
        PlannerKind("clairvoyant_log", f"{_BOUNDS}:clairvoyant_log_paths", foresees=True),
    )
}
"""Built-in planners. From ``one_step`` on they are baselines without goals, for single integrators
only. The last four are performance bounds for tracking, infeasible for real robots."""

PLANNERS = Registry("a planner", "planner.name", OWN, GROUP)


def register_planner(kind: PlannerKind) -> None:
    """Register an external planner for this process and the workers of its studies.

    Parameters
    ----------
    kind
        Planner to register; it replaces a planner registered under the same name.

    Raises
    ------
    InputError
        The argument is not a PlannerKind, or its name is not a word or belongs to a built-in
        planner.

    Examples
    --------
    >>> from planopt.problems.planner_kinds import (
    ...     PlannerKind, planner_names, register_planner, unregister_planner
    ... )
    >>> register_planner(PlannerKind("mine", "my_package.planner:MyPlanner"))
    >>> "mine" in planner_names()
    True
    >>> unregister_planner("mine")
    """
    remedy = "give PlannerKind(name, class), such as PlannerKind('mine', MyPlanner)"
    part_of("kind", kind, PlannerKind, remedy)
    if not isinstance(kind.make, str):
        kind.maker()
    PLANNERS.add(kind.name, kind, key="name")


def unregister_planner(name: str) -> None:
    """Remove a registered planner, if it exists."""
    PLANNERS.registered.pop(name, None)


def registered_planners() -> tuple[PlannerKind, ...]:
    """Return the planners registered by :func:`register_planner`, for worker processes."""
    return tuple(PLANNERS.registered.values())


def planner_names() -> tuple[str, ...]:
    """Return the names of all planners, built-in ones first."""
    return PLANNERS.names()


def planner_kind(name: str) -> PlannerKind:
    """Return the type of planner with a name."""
    found = PLANNERS.find(name)
    if name in OWN or name in PLANNERS.registered:
        return found
    kind = found if isinstance(found, PlannerKind) else PlannerKind(name, found)
    package = getattr(PLANNERS.installed[name], "dist", None)
    version = kind.version or getattr(package, "version", "")
    return replace(kind, name=name, version=version)


def names_with(trait: str) -> str:
    """Return a text that lists the built-in planners with a trait."""
    *first, last = [name for name, kind in OWN.items() if getattr(kind, trait)]
    return f"{', '.join(first)} or {last}"
