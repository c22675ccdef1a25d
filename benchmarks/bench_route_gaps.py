"""Small versions of the studies of doors and of optimality gaps."""

from __future__ import annotations

import pytest
from bound_cases import main as sums
from narrow_doors import main as doors
from one_step_cases import main as one_step
from route_gaps import main as gaps


def test_gaps_of_plan_and_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No gap is negative, and the driven run reaches the goal."""
    monkeypatch.setattr("sys.argv", ["route_gaps", "open_field", "--prove", "1"])
    gaps()
    row = capsys.readouterr().out.splitlines()[-1].strip("| ").split(" | ")
    assert row[0] == "`open_field`" and row[-1] == "reached"
    assert all(0.0 <= float(each) < 20.0 for each in row[2:-1])


def test_narrow_door_is_found(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The scene has a plan through its door."""
    words = ["narrow_doors", "--first-seed", "1000", "--scenes", "1", "--prove", "0.5"]
    monkeypatch.setattr("sys.argv", words)
    doors()
    assert "1 of 1 with a plan" in capsys.readouterr().out


def test_gaps_of_sums(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Tracking has a small gap, and single steps none."""
    words = ["bound_cases", "--first-seed", "1", "--seeds", "1", "--seconds", "3"]
    monkeypatch.setattr("sys.argv", words)
    sums()
    assert "median" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["one_step_cases", "--seeds", "1"])
    one_step()
    rows = capsys.readouterr().out.splitlines()[-4:]
    assert all(float(row.split()[-1]) <= 1e-6 for row in rows)
