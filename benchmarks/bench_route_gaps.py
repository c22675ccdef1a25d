"""Small versions of the studies of doors and of optimality gaps of routes."""

from __future__ import annotations

import pytest
from narrow_doors import main as doors
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
