"""Saved plans and runs with a calibrated law of connection: the law is found again by `check`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planopt import load
from planopt.planning.check.check import check
from planopt.planning.files.saved import save_run, save_solution
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.plan import Verdict
from planopt.planning.solve import solve
from planopt.problems.problem import Problem


@pytest.fixture(scope="module")
def problem() -> Problem:
    """Twelve steps of the open field, calibrated."""
    field = load("open_field")
    return replace(
        field,
        channel=replace(field.channel, calibration="platt"),
        planner=replace(field.planner, max_steps=12, horizon=5),
    )


@pytest.fixture(scope="module")
def simulation(problem):
    """A run of it."""
    return simulate(problem, seed=3)


@pytest.fixture
def run(simulation, tmp_path: Path) -> Path:
    """The run, saved."""
    save_run(simulation, tmp_path / "run")
    return tmp_path / "run"


def edit(folder: Path, **changes: object) -> None:
    """Change arrays of ``belief.npz``; None takes one out."""
    file = folder / "belief.npz"
    with np.load(file) as stored:
        arrays = {name: stored[name] for name in stored.files}
    arrays |= changes
    np.savez(file, **{name: array for name, array in arrays.items() if array is not None})


def test_run_is_found_again(run, simulation):
    """Every plan was made with the law of its time, which outcomes on the way have changed."""
    result = check(run)
    assert result.verdict is Verdict.VERIFIED, result.reasons
    outcomes = simulation.belief.posterior.outcomes
    assert len(outcomes.scores) > outcomes.left_out
    with np.load(run / "belief.npz") as arrays:
        assert arrays["calibrated_at_dbm"] == simulation.problem.stations[0].threshold_dbm
        law = arrays["connection_law"]
    assert law.tolist() == [outcomes.law.intercept, outcomes.law.slope]


def test_plan_is_found_again(problem, tmp_path):
    """A plan rests on the first measurements alone."""
    save_solution(solve(problem, seed=2), tmp_path)
    assert check(tmp_path).verdict is Verdict.VERIFIED


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"connection_law": np.array([0.0, 1.702])}, "connection_law"),
        ({"calibrated_at_dbm": np.array(-99.0)}, "calibrated_at_dbm"),
        ({"calibrated_at_dbm": None}, "calibrated_at_dbm"),
        ({"calibrated_at_dbm": None, "connection_law": None}, "calibrated_at_dbm"),
    ],
)
def test_another_law_is_rejected(run, changes, word):
    """So is a run that leaves the law out."""
    edit(run, **changes)
    result = check(run)
    assert result.verdict is Verdict.VIOLATED
    assert any(word in reason for reason in result.reasons)


def test_a_law_that_nobody_asked_for_is_rejected(simulation, tmp_path):
    """Saved beside a problem that asks for none."""
    plain = replace(simulation.problem.channel, calibration="none")
    run = simulate(replace(simulation.problem, channel=plain), seed=3)
    save_run(run, tmp_path)
    assert check(tmp_path).verdict is Verdict.VERIFIED
    edit(tmp_path, calibrated_at_dbm=np.array(-60.0), connection_law=np.array([0.0, 2.0]))
    result = check(tmp_path)
    assert result.verdict is Verdict.VIOLATED
    assert any("calibrated_at_dbm" in reason for reason in result.reasons)


def test_unreadable_threshold(run):
    """A threshold that is no number of one."""
    edit(run, calibrated_at_dbm=np.array([1.0, 2.0]))
    with pytest.raises(Exception, match="calibrated_at_dbm"):
        check(run)
