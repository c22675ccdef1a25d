"""The command line for problems whose objective is a sum of terms."""

import json
import re
from pathlib import Path

import pytest
from refusals import refused_command

from planopt.cli import main
from planopt.problems.library import library_folder

PROBLEMS = ("outdoor_track", "indoor_learn", "outdoor_map")


@pytest.fixture(params=PROBLEMS)
def short(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Each library problem with a run of three steps and no pictures."""
    text = (library_folder() / f"{request.param}.toml").read_text()
    path = tmp_path / f"{request.param}.toml"
    path.write_text(
        re.sub(r"max_steps = \d+", "max_steps = 3", text) + "\n[report]\nfigures = false\n"
    )
    return path


def printed(capsys: pytest.CaptureFixture[str]) -> dict:
    """The only JSON object on stdout, without NaN or infinity."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    text = capsys.readouterr().out
    assert text.count("\n") == 1
    return json.loads(text, parse_constant=refuse)


def test_solve_and_check(short: Path, tmp_path: Path, capsys) -> None:
    """A plan for each robot is saved and checked."""
    out = tmp_path / "out"
    assert main(["solve", str(short), "--horizon", "3", "--json", "--out", str(out)]) == 0
    data = printed(capsys)
    assert data["sense"] == "max" and data["verdict"] == "verified"
    assert data["bound"] is None and data["gap"] is None
    assert all(len(robot["x_m"]) == 4 for robot in data["robots"])
    assert main(["check", str(out), "--json"]) == 0
    assert printed(capsys)["reasons"] == []


def test_simulate_and_check(short: Path, tmp_path: Path, capsys) -> None:
    """A run that completes its steps is saved and checked."""
    out = tmp_path / "out"
    assert main(["simulate", str(short), "--horizon", "3", "--json", "--out", str(out)]) == 0
    data = printed(capsys)
    assert data["outcome"] == "completed" and data["verified_rate"] == 1.0
    assert sum(data["rungs"].values()) == 3 * len(data["robots"])
    tracks = short.stem == "outdoor_track"
    assert ("time_averaged_trace_p" in data["metrics"]) == (out / "target.csv").is_file() == tracks
    assert set(data["metrics"]) >= {"rms_db", "anmse_db", "trace_m_db", "path_m"}
    assert main(["check", str(out), "--json"]) == 0
    assert printed(capsys)["reasons"] == []


def test_text_says_verdict_and_outcome(short: Path, capsys) -> None:
    assert main(["solve", str(short), "--horizon", "2"]) == 0
    assert capsys.readouterr().out.startswith(f"{short.stem}: verified, horizon 2")
    assert main(["simulate", str(short), "--horizon", "2", "--planner", "random"]) == 0
    printed_words = capsys.readouterr().out
    assert "completed (all 3 steps driven), horizon 2" in printed_words
    assert re.search(r"steps: \d; measurements: \d", printed_words)


def test_what_is_not_verified_is_exit_code_3(short: Path, capsys) -> None:
    """A bound that cannot be kept is said, of plans and runs."""
    text = re.sub(r"threshold_dbm = \S+", "threshold_dbm = 20.0", short.read_text())
    short.write_text(text.replace("[constraints]", "[constraints]\np_min = 0.9"))
    assert main(["solve", str(short), "--horizon", "2"]) == 3
    assert "is met at none of the" in capsys.readouterr().out
    assert main(["simulate", str(short), "--horizon", "2", "--json"]) == 3
    data = printed(capsys)
    assert data["verified_rate"] < 1.0 and data["outcome"] == "completed"


def test_costs_to_go_are_refused(short: Path, capsys) -> None:
    refused_command(capsys, "compare", short, "--horizons", "2", "--costs-to-go", "geodesic")
    refused_command(capsys, "solve", short, "--cost-to-go", "geodesic")


def test_a_run_that_never_connects_is_exit_code_4(tmp_path: Path, capsys) -> None:
    """And one that does ends there, with 0."""
    text = (library_folder() / "indoor_learn.toml").read_text()
    text = text.replace('task = "learn"', 'task = "connect"')
    text = re.sub(r"max_steps = \d+", "max_steps = 3", text) + "\n[report]\nfigures = false\n"
    text = re.sub(r"(\[\[objective\.terms\]\]\n)(?:.+\n)+", r'\1kind = "until_connected"\n', text)
    file = tmp_path / "connect.toml"
    for threshold, code, words in (
        ("-200.0", 0, "completed (connected after step 1)"),
        ("20.0", 4, "step_limit (not connected after planner.max_steps 3)"),
    ):
        file.write_text(re.sub(r"threshold_dbm = \S+", f"threshold_dbm = {threshold}", text))
        assert main(["simulate", str(file), "--horizon", "2"]) == code
        assert words in capsys.readouterr().out


def test_robots_with_dynamics(tmp_path: Path, capsys) -> None:
    """Plan and run are verified, print their states and inputs, and are checked again."""
    text = (library_folder() / "harbour_track.toml").read_text()
    path, out = tmp_path / "harbour.toml", str(tmp_path / "out")
    path.write_text(
        re.sub(r"max_steps = \d+", "max_steps = 3", text) + "\n[report]\nfigures = false\n"
    )
    for command in ("solve", "simulate"):
        assert main([command, str(path), "--horizon", "4", "--json", "--out", out]) == 0
        boat, cart = printed(capsys)["robots"]
        assert len(boat["drive"]["velocity_x_m_s"]) == len(boat["x_m"])
        assert cart["drive"]["heading_rad"][0] == 1.57
        assert cart["drive"]["turn_rate_rad_s"][0] is None
        assert main(["check", out, "--json"]) == 0
        assert printed(capsys)["reasons"] == []
    refused_command(capsys, "simulate", path, "--planner", "random")
