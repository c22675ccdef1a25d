"""Closed loops over random scenes, in small: no fault, and nothing that the checker rejects."""

from pathlib import Path

import pytest

from planopt.extend import Rung

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.parametrize("first", range(0, 24, 6))
def test_random_scenes(first, tmp_path, monkeypatch):
    """Six scenes of two steps each, judged from disk; every plan names its rung and verdict."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    from closed_loop_tally import drive

    for seed in range(first, first + 6):
        tally = drive(seed, tmp_path / str(seed), max_steps=2)
        assert not tally.faults
        assert not tally.rejected
        assert sum(tally.rungs.values()) == sum(tally.verdicts.values()) == tally.steps
        assert set(tally.rungs) <= set(Rung)
        assert tally.steps > 0 or tally.outcomes


@pytest.mark.parametrize(("seed", "steps"), [(36, 4), (1007, 12)])
def test_steps_that_effort_makes_dear_lead_on(seed, steps, tmp_path, monkeypatch):
    """Also where any move of the lattice costs more than it is worth."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    from closed_loop_tally import drive

    tally = drive(seed, tmp_path, max_steps=steps)
    assert tally.verdicts == {"verified": steps}
    assert not tally.faults
    assert not tally.rejected
