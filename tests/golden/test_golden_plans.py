"""A change that is to keep plans keeps them: the library against its record."""

from __future__ import annotations

import copy

import pytest
from golden_plans import (
    DRIVEN,
    PATH_M,
    PROBLEMS,
    SEEDS,
    differences,
    driven,
    read_record,
    solved,
)

RECORD = read_record()


def test_record_is_whole() -> None:
    """Every problem of the library is recorded with every seed, and nothing else is."""
    names = {f"{name} seed {seed}" for name in PROBLEMS for seed in SEEDS}
    assert set(RECORD) == names | {f"{name} driven" for name in DRIVEN}


@pytest.mark.parametrize("name", PROBLEMS)
def test_first_plans(name: str) -> None:
    """Verdict, fallback, termination, objective and path as recorded, seed 0."""
    assert differences(RECORD[f"{name} seed 0"], solved(name, 0)) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS[1:])
@pytest.mark.parametrize("name", PROBLEMS)
def test_first_plans_of_further_seeds(name: str, seed: int) -> None:
    """The same of further seeds."""
    assert differences(RECORD[f"{name} seed {seed}"], solved(name, seed)) == []


@pytest.mark.parametrize("name", DRIVEN)
def test_first_steps(name: str) -> None:
    """Driven path, fallbacks and verdicts of a closed loop's first steps as recorded."""
    assert differences(RECORD[f"{name} driven"], driven(name)) == []


def test_differences_are_told() -> None:
    """A worse objective, another verdict, fallback or path is each told; the record itself not."""
    golden = RECORD["open_field seed 0"]
    assert differences(golden, copy.deepcopy(golden)) == []
    for change, words in (
        ({"objective": golden["robots"][0]["objective"] * 1.0001}, "objective"),
        ({"verdict": "violated"}, "verdict verified is now violated"),
        ({"rung": "stop"}, "rung plan is now stop"),
        ({"termination": "acceptable"}, "termination"),
        ({"x_m": [x + 2 * PATH_M for x in golden["robots"][0]["x_m"]]}, "m away"),
        ({"x_m": [0.0], "y_m": [0.0]}, "places"),
    ):
        now = copy.deepcopy(golden)
        now["robots"][0] |= change
        found = differences(golden, now)
        assert len(found) == 1 and words in found[0], change
    assert "verdict" in differences(golden, {"verdict": "none", "robots": []})[0]
