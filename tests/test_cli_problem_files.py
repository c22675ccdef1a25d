"""``planopt init``, ``show`` and ``validate``."""

import json
from pathlib import Path

import numpy as np
import pytest
from refusals import refused_command

from planopt import OutputError, load
from planopt.cli import main
from planopt.problems import list_problems, problem_from_dict, problem_to_dict
from planopt.problems.tasks import MOTION
from planopt.studies.bench_cases import library_names

NAMES = library_names(MOTION)


@pytest.mark.parametrize("name", NAMES)
def test_a_copy_is_the_problem(name: str, tmp_path: Path, capsys) -> None:
    """With its maps next to it, whatever the library's folder is; nothing temporary is left."""
    file = tmp_path / "new" / "mine.toml"
    assert main(["init", str(file), "--from", name, "--json"]) == 0
    files = {Path(path) for path in json.loads(capsys.readouterr().out)["files"]}
    assert files == {path for path in file.parent.rglob("*") if path.is_file()}
    copy, original = problem_to_dict(load(file)), problem_to_dict(load(name))
    folders = [(copy, file.parent), (original, list_problems()[0].path.parent)]
    assert _relative(*folders[0]) == _relative(*folders[1])


def _relative(tables: object, folder: Path) -> str:
    return json.dumps(tables).replace(str(folder), "")


def test_nothing_is_overwritten(tmp_path: Path, capsys) -> None:
    """Two problems may share a map; what differs stays, and nothing else is written."""
    courier, hard = tmp_path / "courier.toml", tmp_path / "hard.toml"
    assert main(["init", str(courier), "--from", "munich_courier"]) == 0
    assert main(["init", str(hard), "--from", "munich_hard"]) == 0
    (tmp_path / "data" / "munich_buildings.json").write_text("mine")
    third = tmp_path / "third.toml"
    capsys.readouterr()
    refused_command(capsys, "init", third, "--from", "munich_hard")
    assert not third.exists()
    assert (tmp_path / "data" / "munich_buildings.json").read_text() == "mine"
    courier.write_text("mine")
    refused_command(capsys, "init", courier)
    assert courier.read_text() == "mine"


def test_init_that_fails_leaves_nothing(tmp_path: Path, capsys, monkeypatch) -> None:
    """Folders that were made for the files go again, as on a full disk."""

    def full(path: Path, write: object) -> None:
        raise OutputError(f"{path}: cannot be written: No space left on device")

    monkeypatch.setattr("planopt.files.writing.write_whole", full)
    refused_command(capsys, "init", tmp_path / "new" / "p.toml", "--from", "munich_courier")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [["p.toml", "--from", "nowhere"], ["p.toml", "--from", "../open_field"], ["p.json"]],
)
def test_what_cannot_begin(arguments: list[str], tmp_path: Path, capsys) -> None:
    name, *more = arguments
    refused_command(capsys, "init", tmp_path / name, *more)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", NAMES)
def test_show(name: str, capsys) -> None:
    """A line for each robot and station; the JSON is the problem in full."""
    problem = load(name)
    assert main(["show", name]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{name}: {problem.description}"
    for word, things in (("robot", problem.robots), ("station", problem.stations)):
        named = [line.split()[1] for line in lines[1:] if line.strip().startswith(word)]
        assert named == [thing.name for thing in things]
    assert main(["show", name, "--json"]) == 0
    assert problem_from_dict(json.loads(capsys.readouterr().out), file=problem.file) == problem


def test_validate_reads_what_the_problem_names(tmp_path: Path, capsys) -> None:
    """A problem file may be sound and its map not."""
    file = tmp_path / "p.toml"
    assert main(["init", str(file), "--from", "munich_courier"]) == 0
    assert main(["validate", str(file), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["valid"] is True and told["measurements"] == 300
    np.savez(tmp_path / "data" / "munich_mast45m.npz", x_m=np.arange(3.0))
    assert main(["show", str(file)]) == 0
    capsys.readouterr()
    refused_command(capsys, "validate", file)
