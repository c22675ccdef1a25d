"""The study of deadlines on one small problem: it drives, remembers and prints."""

from __future__ import annotations

from pathlib import Path

import pytest
from step_deadlines import STRESS, STRESS_STEPS, Timed, line_of, main, read_log, scene, timed

from planopt import load
from planopt.problems.tasks import MOTION
from planopt.studies.bench_cases import library_names


def test_line_counts_late_steps() -> None:
    """Worked out by hand: two runs with a deadline of 1 s, one of whose four steps is late."""
    runs = [
        Timed("a", 0, None, [1.0, 3.0], 1.0),
        Timed("a", 0, 1.0, [0.5, 1.1, 0.5], 2.0 / 3.0),
        Timed("a", 1, 1.0, [1.3], 1.0),
    ]
    assert line_of("a", runs, 1.0) == (
        "| a | 4 | 2000, 2900, 3000 | 100.0 | 800, 1270, 1300 | 1 | 75.0 |"
    )


def test_study_prints_and_remembers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One run with a deadline and one without; asked again, they are read and not driven."""
    log = tmp_path / "runs.jsonl"
    words = ["step_deadlines", "--problems", "harbour_reach", "--budget", "2", "--log", str(log)]
    monkeypatch.setattr("sys.argv", words)
    main()
    first = capsys.readouterr().out
    free, held = read_log(log)
    assert (free.budget_s, held.budget_s) == (None, 2.0)
    assert free.step_s and held.step_s and held.verified_rate == 1.0
    monkeypatch.setattr("step_deadlines.timed", timed_nothing)
    main()
    assert capsys.readouterr().out == first


def test_larger_scenes_are_larger() -> None:
    """Each is what its name says; none is driven here."""
    made = {name: scene(name) for name in STRESS}
    assert all(problem.planner.max_steps == STRESS_STEPS for problem in made.values())
    for name in ("munich_hard_20", "connect_street_20", "connect_rooftop_20"):
        assert made[name].planner.horizon == 20
    assert len(made["couriers_5"].robots) == 5
    plain = load("two_station_courier").workspace.obstacles
    assert len(made["two_station_courier_thrice"].workspace.obstacles) == 3 * len(plain) > 0
    assert made["harbour_traffic_unsure"].constraints.rule.parameter_uncertainty == "all"


def test_no_path_is_left_out() -> None:
    """The problem without a free path is in the library, and has no steps to time."""
    assert "munich_courtyard" in library_names(MOTION)
    assert timed("munich_courtyard", 0, None) is None


def timed_nothing(name: str, seed: int, budget_s: float | None) -> None:
    """Stand in for a run that must not happen."""
    raise AssertionError(f"{name}, seed {seed}, budget {budget_s} was driven again")
