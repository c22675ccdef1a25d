"""Bad input on the command line: exit code 2, one line on stderr, nothing half-written."""

import json
from pathlib import Path

import pytest
from refusals import refused_command

from planopt.cli import main
from planopt.problems.library import library_folder

OPEN_FIELD = (library_folder() / "open_field.toml").read_text()


@pytest.mark.parametrize("command", ["solve", "simulate", "compare"])
def test_a_bad_problem(command: str, tmp_path: Path, capsys) -> None:
    """Every command that reads a problem names file and key, and leaves no folder."""
    path, out = tmp_path / "bad.toml", tmp_path / "out"
    path.write_text(OPEN_FIELD.replace("speed_max_m_s = 2.0", "speed_max_m_s = -2.0"))
    more = ["--horizons", "2"] if command == "compare" else []
    refused_command(capsys, command, path, "--json", "--out", out, *more)
    assert not out.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["frob"],
        ["solve"],
        ["solve", "no_such_problem"],
        ["solve", "no/such/file.toml"],
        ["solve", "open_field", "--horizon", "0"],
        ["solve", "open_field", "--horizon", "10000"],
        ["solve", "open_field", "--horizon", "ten"],
        ["solve", "open_field", "--planner", "magic"],
        ["solve", "open_field", "--cost-to-go", "none"],
        ["solve", "open_field", "--seed", "-1"],
        ["solve", "open_field", "--frob"],
        ["simulate", "open_field", "--horizon", "501"],
        ["compare", "open_field"],
        ["compare", "open_field", "--horizons", ""],
        ["compare", "open_field", "--horizons", "1,,2"],
        ["compare", "open_field", "--horizons", "1,b"],
        ["compare", "open_field", "--horizons", "1,0"],
        ["compare", "open_field", "--horizons", "1,10000"],
        ["compare", "open_field", "--horizons", "1", "--planners", "auto,"],
        ["compare", "open_field", "--horizons", "1", "--planners", "magic"],
        ["compare", "open_field", "--horizons", "1", "--costs-to-go", "magic"],
        ["compare", "open_field", "--horizons", "1", "--seeds", "1,2"],
        ["compare", "open_field", "--horizons", "1", "--seeds", "0"],
        ["compare", "open_field", "--horizons", "1", "--workers", "0"],
        ["compare", "open_field", "--horizons", "1", "--backend", "magic"],
        ["check", "no_such_folder"],
    ],
)
def test_bad_usage(arguments: list[str], capsys) -> None:
    refused_command(capsys, *arguments)


def test_an_error_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One object says what was wrong, where, and what to do; null is what is not known."""
    (tmp_path / "log.csv").write_text("x_m,y_m,power_dbm\n1,2,many\n")
    log = str(tmp_path / "log.csv")
    assert main(["fit", log, "--station", "0,0", "--json"]) == 2
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {"error", "file", "key", "row", "remedy"}
    assert (found["file"], found["key"], found["row"]) == (log, "power_dbm", 2)
    assert main(["solve", "--json", "--frob"]) == 2
    found = json.loads(capsys.readouterr().out)
    assert "--frob" in found["error"] and found["file"] is None


@pytest.mark.parametrize(
    "arguments",
    [
        ["solve", "open_field"],
        ["simulate", "open_field"],
        ["compare", "open_field", "--horizons", "2"],
    ],
)
def test_an_output_folder_that_cannot_be_written(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    """It is found before any work is done."""

    def work(*_: object, **__: object) -> None:
        raise AssertionError("work was done")

    for module in ("planning.solve.solve", "planning.solve.simulate"):
        monkeypatch.setattr(f"planopt.{module}", work)
    monkeypatch.setattr("planopt.studies.compare.compare", work)
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        refused_command(capsys, *arguments, "--out", out)
    assert (tmp_path / "file").read_text() == "mine"
    assert [f.name for f in tmp_path.iterdir()] == ["file"]


def test_a_bad_log_leaves_an_existing_folder_as_it_was(tmp_path: Path, capsys) -> None:
    """A log that turns out bad after the folder was found good: nothing is written or removed."""
    (tmp_path / "log.csv").write_text("x_m,y_m,power_dbm\n1,2,many\n")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "plan.json").write_text("mine")
    path = tmp_path / "field.toml"
    columns = 'columns = {x = "x_m", y = "y_m", power = "power_dbm"}'
    path.write_text(OPEN_FIELD.replace("count = 120", f'file = "log.csv"\n{columns}'))
    refused_command(capsys, "solve", path, "--out", tmp_path / "out")
    assert (tmp_path / "out" / "plan.json").read_text() == "mine"
    assert len(list((tmp_path / "out").iterdir())) == 1
