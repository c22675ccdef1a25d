"""The study of realised costs on one small problem: it drives, remembers and prints."""

from __future__ import annotations

from pathlib import Path

import pytest
from reach_costs import line_of, main, paired_line_of, reach_problems, read_log


def test_problems_have_a_free_path() -> None:
    """All reach problems of the library but the one without a free path."""
    names = reach_problems()
    assert "open_field" in names and "munich_hard" in names
    assert "munich_courtyard" not in names and "no_route_hard" not in names
    assert "indoor_learn" not in names


def test_study_prints_and_remembers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run costs at least about the clairvoyant's; asked again, it is read and not driven."""
    log = tmp_path / "runs.jsonl"
    words = ["reach_costs", "--problems", "harbour_reach", "--seeds", "1", "--log", str(log)]
    monkeypatch.setattr("sys.argv", words)
    main()
    first = capsys.readouterr().out
    (record,) = read_log(log)
    assert record.outcome == "reached" and 0.9 < record.cost_ratio < 2.0
    assert line_of("harbour_reach", [record]) in first
    assert paired_line_of("harbour_reach", [record]) in first
    assert 0.9 < record.plain_cost_ratio < 2.0 and 0.9 < record.knowing_cost_ratio < 1.2
    monkeypatch.setattr("reach_costs.drive", drive_nothing)
    main()
    assert capsys.readouterr().out == first


def drive_nothing(name: str, seed: int, horizon: int, charge: str) -> None:
    """Stand in for a drive that must not happen."""
    raise AssertionError(f"{name}, seed {seed}, horizon {horizon} was driven again")
