"""The script behind the table of calibrated probabilities: which prediction meets which truth."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planopt import load

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch):
    """The script as a module."""
    monkeypatch.syspath_prepend(str(DOCS))
    import measure_calibration  # pyright: ignore[reportMissingImports]

    yield measure_calibration
    sys.modules.pop("measure_calibration")


def test_what_is_compared_is_that_of_the_run(script) -> None:
    """Without calibration both ways to the probability of driven steps are the run's own."""
    problem = load("open_field")
    short = replace(problem, planner=replace(problem.planner, max_steps=4))
    driven = script.drive(short, 4)
    predicted, realised = script.outcomes(driven, 1)
    np.testing.assert_array_equal(predicted, driven.run.log.connectivity[1:])
    np.testing.assert_array_equal(realised, driven.run.log.connected[1:])
    np.testing.assert_allclose(script.normal_probabilities(driven), predicted, rtol=1e-8)
    robot = driven.problem.robots[0]
    assert np.linalg.norm(np.subtract(robot.goal_m, robot.start_m)) >= 50.0


def test_main_prints_three_tables(script, capsys: pytest.CaptureFixture[str]) -> None:
    """Calibrated one and several steps ahead, and the normal law beside it."""
    script.main("open_field", "2", "4", "2")
    printed = capsys.readouterr().out
    assert "0 of 2 runs reached the goal" in printed
    for words in ("calibration platt, driven", "calibration platt, 5 steps ahead", "normal law"):
        assert f"\n{words}" in printed
    assert printed.count("no interval from fewer than 5 runs") == 3
