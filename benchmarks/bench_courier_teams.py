"""The study of courier teams on one small team: it drives, counts, remembers and prints."""

from __future__ import annotations

from pathlib import Path

import courier_teams
import numpy as np
import pytest
from courier_teams import drawn_problem, least_distances_m, line_of, main, read_log

from planopt import load


def test_places_are_drawn_by_the_seed() -> None:
    """Every goal is the start of the next one, and no two starts are near each other."""
    base = load("munich_courier")
    problem = drawn_problem(base, 3, 7)
    starts = [robot.start_m for robot in problem.robots]
    assert [robot.goal_m for robot in problem.robots] == [*starts[1:], starts[0]]
    apart = [np.linalg.norm(np.subtract(a, b)) for a in starts for b in starts if a != b]
    assert min(apart) >= courier_teams.LEAST_M
    assert drawn_problem(base, 3, 7).robots == problem.robots != drawn_problem(base, 3, 8).robots


def test_distances_are_between_the_ends_of_steps_too() -> None:
    """Two that swap places are at the same place half-way."""
    ends = np.array([[0.0, 0.0], [4.0, 0.0]])
    assert least_distances_m(ends, ends[::-1]) == pytest.approx([0.0])
    assert least_distances_m(ends, ends + np.array([0.0, 3.0])) == pytest.approx([3.0])


def test_study_prints_and_remembers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run is driven once; asked again, it is read."""
    monkeypatch.setattr(courier_teams, "LEAST_M", 30.0)
    log = tmp_path / "runs.jsonl"
    words = "courier_teams --problem open_field --counts 2 --seeds 1 --log".split()
    monkeypatch.setattr("sys.argv", [*words, str(log)])
    main()
    first = capsys.readouterr().out
    (record,) = read_log(log)
    assert (record.outcome, record.contacts) == ("reached", 0)
    assert record.least_m >= courier_teams.SEPARATION_M - 1e-6
    assert line_of([record]) in first
    monkeypatch.delattr(courier_teams, "drive")
    main()
    assert capsys.readouterr().out == first
