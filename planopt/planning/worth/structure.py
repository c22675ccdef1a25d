"""Which places of a path a worth couples: what may be searched and solved by stages."""

from __future__ import annotations

from planopt.objectives.terms.term import Structure
from planopt.problems.problem import Problem


def structure_of(problem: Problem) -> Structure:
    """How the worth of a path couples its places.

    A dynamic programme over places is exact unless it couples all of them.
    """
    found = {term.structure for term in problem.terms}
    if "full" in found:
        return "full"
    return "chain" if "chain" in found else "stagewise"


def bends_starts(problem: Problem, *, steered: bool = True) -> bool:
    """Whether the places of a path are coupled by a term that no lattice search stands in for.

    Then paths in all directions are tried besides those of the lattice, and more are followed. A
    term that steers the robot may do without them, but not where it is steered nowhere.
    """
    return any(
        term.structure == "full"
        and (term.bends_starts or (not steered and term.steers is not None))
        for term in problem.terms
    )
