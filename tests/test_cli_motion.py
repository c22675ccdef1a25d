"""The command line for the library's problem of robots that cannot turn or stop at will."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from planopt.cli import main
from planopt.problems.library import library_folder


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """The library problem with a run of three steps and no pictures."""
    text = (library_folder() / "harbour_track.toml").read_text()
    path = tmp_path / "harbour_track.toml"
    path.write_text(
        re.sub(r"max_steps = \d+", "max_steps = 3", text) + "\n[report]\nfigures = false\n"
    )
    return path


@pytest.mark.parametrize("command", ["solve", "simulate"])
def test_verified_saved_and_judged_again(command: str, short: Path, tmp_path: Path, capsys) -> None:
    """Exit code 0 of all, and the states in what is printed."""
    out = tmp_path / "out"
    assert main([command, str(short), "--horizon", "4", "--json", "--out", str(out)]) == 0
    boat, cart = json.loads(capsys.readouterr().out)["robots"]
    assert len(boat["drive"]["velocity_x_m_s"]) == len(boat["x_m"])
    assert cart["drive"]["heading_rad"][0] == 1.57
    assert cart["drive"]["turn_rate_rad_s"][0] is None
    assert main(["check", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["reasons"] == []


def test_other_planners_are_refused(short: Path, capsys) -> None:
    """With the key, and what to use."""
    assert main(["simulate", str(short), "--planner", "random"]) == 2
    words = capsys.readouterr().err
    assert "planner.name" in words and "use auto, nlp, scp or lattice" in words
