"""Terms from outside planopt: their tables are read, checked and saved like planopt's own."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import pytest
from pydantic import Field
from refusals import refused

from planopt.extend import Term
from planopt.objectives.terms.term import registered_terms
from planopt.problems import problem_from_dict, problem_to_dict
from planopt.problems.schema import json_schema


@pytest.fixture
def corridor(own_parts):
    """Define a term with keys of its own; it is forgotten after the test."""

    @dataclass(frozen=True)
    class CorridorTerm(Term):
        """Keep near a line."""

        y_m: Annotated[float, Field(ge=0.0, le=9.0, description="Height of the line in metres.")]
        width_m: Annotated[float, Field(gt=0.0)] = 2.0

        kind: ClassVar[str] = "corridor"

    return CorridorTerm


def with_terms(tables, *terms):
    del tables["robots"][0]["goal_m"]
    tables["problem"]["task"] = "custom"
    tables["objective"] = {"terms": list(terms)}
    return tables


def test_an_own_term_is_read_and_saved(corridor, tables, built):
    """Its keys, its defaults, and the same term after saving."""
    problem = built(with_terms(tables, {"kind": "corridor", "y_m": 3.0}))
    assert problem.task == "custom"
    assert problem.terms == (corridor(3.0, 2.0),)
    saved = problem_to_dict(problem)
    assert saved["objective"]["terms"] == [
        {"kind": "corridor", "weight": 1.0, "y_m": 3.0, "width_m": 2.0}
    ]
    assert problem_from_dict(saved, file=problem.file).terms == problem.terms


@pytest.mark.parametrize("table", [{"y_m": 10.0}, {"y_m": "3"}, {"y_m": 3.0, "with_m": 1.0}, {}])
def test_slips_in_an_own_term_are_named(corridor, tables, built, table):
    """Key, value and what is allowed, from the annotations of the class alone."""
    with refused():
        built(with_terms(tables, {"kind": "corridor", **table}))


def test_an_own_term_is_in_the_schema_while_it_is_registered(corridor):
    """The JSON schema describes its keys; kinds that are not registered are refused."""
    definition = json_schema()["$defs"]["CorridorTable"]
    assert definition["description"] == "Keep near a line."
    assert definition["properties"]["y_m"]["maximum"] == 9.0
    assert definition["required"] == ["kind", "y_m"]


def test_a_kind_that_is_not_registered_is_refused(tables, built):
    """The kinds that are known stand in the message."""
    with refused():
        built(with_terms(tables, {"kind": "corridor", "y_m": 3.0}))


def test_no_two_terms_have_one_kind(corridor):
    """The second class is refused; the first stays."""
    with refused():
        type("Other", (Term,), {"kind": "corridor"})
    assert corridor in registered_terms()
