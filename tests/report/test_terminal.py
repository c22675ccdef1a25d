"""Frames of a run for a terminal, and the option --live."""

from collections.abc import Sequence

import numpy as np
import pytest
import shapely
from refusals import refused_command

import planopt
from planopt.cli import main
from planopt.planning.plan import Plan
from planopt.report.motion_words import TerminalMap


def test_frames_show_the_run() -> None:
    """Obstacles where they are, one robot at its position, its plan and its driven path."""
    problem = planopt.load("open_field")
    frames: list[str] = []
    made: list[Plan] = []
    drawn = TerminalMap(problem, 60, 25)

    def keep(step: int, plans: Sequence[Plan]) -> None:
        frames.append(drawn.frame(step, plans))
        made.extend(plans)

    run = planopt.simulate(problem, horizon=3, on_plans=keep)
    assert isinstance(run, planopt.Run)
    assert len(frames) == len(run.plans[0])
    for frame, plan in zip(frames, made, strict=True):
        lines = frame.split("\n")
        picture = np.array([list(line[1:-1]) for line in lines[1:26]])
        assert picture.shape == (25, 60) and (picture == "1").sum() == 1
        (row,), (column,) = np.nonzero(picture == "1")
        centre = np.array([2.0 * (column + 0.5), 100.0 - 4.0 * (row + 0.5)])
        assert (np.abs(centre - plan.positions_m[0]) <= (1.0, 2.0)).all()
        assert f"rover at ({plan.positions_m[0][0]:.1f}" in lines[-1]
        row, column = np.nonzero(picture == "#")
        places = np.stack([2.0 * (column + 0.5), 100.0 - 4.0 * (row + 0.5)], axis=1)
        union = shapely.union_all([each.polygon for each in problem.workspace.obstacles])
        assert len(places) > 20 and shapely.contains_xy(union, *places.T).all()
    assert "." in frames[-1] and "." not in frames[0].split("+")[2]


def test_live(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """A line for each step without a terminal, a cleared screen on one; for motion only."""
    assert main(["simulate", "open_field", "--horizon", "2", "--live", "--json"]) == 0
    lines = [each for each in capsys.readouterr().err.split("\n") if "rover at (" in each]
    assert len(lines) > 20 and all(each.isprintable() for each in lines)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    assert main(["simulate", "open_field", "--horizon", "1", "--live"]) in (0, 3)
    assert capsys.readouterr().err.count("\x1b[H\x1b[2J+--") > 20
    refused_command(capsys, "simulate", "coverage_plain", "--live")
