"""Which places of a path a worth couples: what may be searched and solved by stages."""

from __future__ import annotations

from planopt.planning.programme.path_value import Structure
from planopt.problems.objective import (
    LearningTerm,
    MappingTerm,
    MotionEnergyTerm,
    Term,
    TrackingTerm,
    TransmissionEnergyTerm,
    UntilConnectedTerm,
)
from planopt.problems.problem import Problem


def structure_of(problem: Problem) -> Structure:
    """How the worth of a path couples its places.

    A dynamic programme over places is exact unless it couples all of them.
    """
    found = {_structure(term) for term in problem.terms}
    if "full" in found:
        return "full"
    return "chain" if "chain" in found else "stagewise"


def is_measured(term: Term) -> bool:
    """Whether a term is worth what measurements along a path tell."""
    return isinstance(term, LearningTerm) or (
        isinstance(term, MappingTerm) and term.form != "two_layer"
    )


def shares_measurements(term: Term) -> bool:
    """Whether what one place tells, or a try at it, lessens what another is worth."""
    return isinstance(term, UntilConnectedTerm) or is_measured(term)


def _structure(term: Term) -> Structure:
    match term:
        case (
            TrackingTerm(form="additive") | MappingTerm(form="two_layer") | TransmissionEnergyTerm()
        ):
            return "stagewise"
        case MotionEnergyTerm():
            return "chain"
        case _:
            return "full"
