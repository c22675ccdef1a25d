"""The planners that a problem may name: those of planopt, and those that others register.

A package adds planners by the entry-point group ``planopt.planners``, whose names are the planners'
and whose objects are a :class:`PlannerKind` or what makes a planner; a program by
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
"""Entry points of planners from outside."""

_HOME = "planopt.planning.planners"
_BOUNDS = "planopt.planning.foresight"


@dataclass(frozen=True)
class PlannerKind:
    """A planner that problems may name.

    Attributes
    ----------
    name
        Value of the key ``planner.name``.
    make
        Called with the problem of one robot, its geometry and a random generator; gives an object
        with the method ``plan`` of :class:`planopt.planning.planners.Planner`. Or where that is:
        ``module:name``, imported when it is needed.
    reaches_goals
        Whether it plans for the task ``reach``; only planopt's own do.
    has_dynamics
        Whether it plans for robots with dynamics other than the single integrator.
    searches
        Whether it has a global search, whose paths fall back on each other.
    solves
        Whether a solver runs: only then may a plan report its termination, iterations and residual.
    foresees
        Whether it knows the ground truth, as a bound on what planners can do. ``make`` is then
        called with the problem of all robots, the first station's ground truth, and the target's
        path; it gives the paths of all robots for the whole run.
    tracks
        Whether it plans for nothing but tracking a target.
    version
        Of a planner from outside: studies do not take results of another version from a record.
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
        """Return what makes the planner.

        Raises
        ------
        InputError
            It cannot be imported.
        """
        if not isinstance(self.make, str):
            return self._callable(self.make)
        module, _, attribute = self.make.partition(":")
        try:
            return self._callable(getattr(import_module(module), attribute))
        except (ImportError, AttributeError, ValueError) as error:
            raise InputError(
                f"is {self.name}, whose {self.make} cannot be imported: {error}",
                key="planner.name",
                remedy="install what it needs, or name another planner",
            ) from None

    def _callable(self, make: Any) -> Callable[..., Any]:
        """Return what makes the planner, which must be a class or function."""
        if not callable(make):
            raise InputError(
                f"of {self.name!r} is a {type(make).__name__}, nothing that can be called",
                key="PlannerKind.make",
                remedy="give the planner's class, not an instance of it, or 'module:name'",
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
"""planopt's own. All from ``one_step`` on are baselines: no goal, and only robots that can turn and
stop at will. The last four are bounds on tracking, which no robot could follow."""

PLANNERS = Registry("a planner", "planner.name", OWN, GROUP)


def register_planner(kind: PlannerKind) -> None:
    """Let problems name a planner from outside, in this process and in workers of its studies.

    Parameters
    ----------
    kind
        The planner; one that was registered under its name before is replaced.

    Raises
    ------
    InputError
        It is no PlannerKind, its name is no word, or one of planopt's own, or the planner is said
        to reach goals.

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
    PLANNERS.add(kind.name, _without_goals(kind), key="name")


def unregister_planner(name: str) -> None:
    """Forget a registered planner; nothing happens if there is none."""
    PLANNERS.registered.pop(name, None)


def registered_planners() -> tuple[PlannerKind, ...]:
    """Return what :func:`register_planner` was given, for worker processes."""
    return tuple(PLANNERS.registered.values())


def planner_names() -> tuple[str, ...]:
    """Return the names of all planners: planopt's own first."""
    return PLANNERS.names()


def planner_kind(name: str) -> PlannerKind:
    """Return the planner of a name."""
    found = PLANNERS.find(name)
    if name in OWN or name in PLANNERS.registered:
        return found
    kind = found if isinstance(found, PlannerKind) else PlannerKind(name, found)
    package = getattr(PLANNERS.installed[name], "dist", None)
    version = kind.version or getattr(package, "version", "")
    return _without_goals(replace(kind, name=name, version=version))


def _without_goals(kind: PlannerKind) -> PlannerKind:
    """Return the planner; only planopt's own may reach goals."""
    if kind.reaches_goals:
        raise InputError(
            f"{kind.name} is said to plan for the task reach, "
            f"which only {names_with('reaches_goals')} do",
            key="reaches_goals",
            remedy="leave it False; a goal can be a term of the task custom",
        )
    return kind


def names_with(trait: str) -> str:
    """Return planopt's own planners that have a trait, in words."""
    *first, last = [name for name, kind in OWN.items() if getattr(kind, trait)]
    return f"{', '.join(first)} or {last}"
