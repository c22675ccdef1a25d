"""Single settings changed in a problem."""

from __future__ import annotations

from dataclasses import replace

import pytest

from planopt.errors import InputError
from planopt.problems.load import load
from planopt.problems.overrides import with_overrides


def test_only_the_named_settings_change() -> None:
    """The result is the problem with exactly these fields replaced."""
    problem = load("open_field")
    changed = with_overrides(problem, horizon=20, planner="lattice", cost_to_go="geodesic")
    assert changed == replace(
        problem,
        planner=replace(problem.planner, horizon=20, name="lattice"),
        objective=replace(problem.objective, cost_to_go="geodesic"),
    )


def test_nothing_named_nothing_changed() -> None:
    """Without settings the problem is as it was."""
    problem = load("open_field")
    assert with_overrides(problem) == problem


@pytest.mark.parametrize("horizon", [0, 501, 10_000, -1])
def test_horizon_out_of_range_has_the_error_of_the_file(horizon: int) -> None:
    """The range is the schema's; no file is named, since the value is in none."""
    with pytest.raises(InputError, match="should be at least 1 and at most 500") as caught:
        with_overrides(load("open_field"), horizon=horizon)
    assert caught.value.key == "planner.horizon"
    assert caught.value.file is None


def test_unknown_names_say_what_there_is() -> None:
    """A planner or cost to go that does not exist is answered with those that do."""
    with pytest.raises(InputError, match="'auto', 'nlp', 'scp', 'lattice'") as caught:
        with_overrides(load("open_field"), planner="magic")
    assert caught.value.key == "planner.name"
    with pytest.raises(InputError, match="'geodesic' or 'connected'") as caught:
        with_overrides(load("open_field"), cost_to_go="zero")
    assert caught.value.key == "objective.cost_to_go"
