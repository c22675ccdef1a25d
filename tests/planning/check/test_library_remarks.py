"""How a saved problem differs from the library's of its name."""

from dataclasses import replace

import pytest

from planopt import load
from planopt.errors import InputError
from planopt.planning.check import check as module
from planopt.planning.check.check import library_remarks
from planopt.problems.load import with_overrides


def test_the_library_s_own_is_not_remarked_upon() -> None:
    """Nor are horizon, planner and cost to go, which the command line may change."""
    problem = load("open_field")
    assert library_remarks("plan.json", problem) == []
    changed = with_overrides(problem, horizon=3, planner="lattice", cost_to_go="geodesic")
    assert library_remarks("plan.json", changed) == []


def test_an_edited_bound_is() -> None:
    """With the key, both values and where the other one comes from."""
    problem = load("open_field")
    easier = replace(problem, constraints=replace(problem.constraints, p_min=0.5))
    assert library_remarks("run.json", easier) == [
        "run.json, key problem_file.constraints.p_min: 0.5, in the library's open_field 0.8"
    ]


def test_a_problem_of_one_s_own_is_taken_as_it_stands() -> None:
    """Nothing tells whether it is the one that was meant; that is said."""
    (remark,) = library_remarks("plan.json", replace(load("open_field"), name="my_field"))
    assert "problem.name: my_field is not in the library" in remark


def test_a_library_that_cannot_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """Is no reason not to judge."""

    def fail(_: object) -> None:
        raise InputError("is damaged")

    problem = load("open_field")
    monkeypatch.setattr(module, "load_motion", fail)
    (remark,) = library_remarks("plan.json", problem)
    assert "cannot be compared with the library's: is damaged" in remark
