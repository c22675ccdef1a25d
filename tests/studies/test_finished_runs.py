"""Studies go on where they were stopped: finished runs are taken, others are driven."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from planopt import Comparison, Problem, compare, load
from planopt.files.writing import write_whole
from planopt.planning.loop.results import RunSummary
from planopt.problems import problem_to_dict
from planopt.problems.problem import problem_from_tables
from planopt.studies import compare as compare_module
from planopt.studies import study
from planopt.studies.study import FinishedRuns, run_key


def short(name: str, steps: int = 2) -> Problem:
    problem = load(name)
    return replace(problem, planner=replace(problem.planner, max_steps=steps, horizon=2))


@pytest.fixture
def driven(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """Horizon and seed of every run that is driven in this process."""
    seen: list[tuple[int, int]] = []
    original = compare_module._drive

    def counted(asked, shared):
        problem, seed = asked
        seen.append((problem.planner.horizon, seed))
        return original(asked, shared)

    monkeypatch.setattr(compare_module, "_drive", counted)
    return seen


def compared(problem: Problem, folder: Path, horizons=(1, 2), **more) -> Comparison:
    if problem.task == "reach":
        more["costs_to_go"] = ["geodesic"]
    return compare(problem, horizons, finished=folder, **{"seeds": 2, **more})


@pytest.mark.parametrize("name", ["open_field", "outdoor_map"])
def test_the_same_comparison_again_drives_nothing(name, tmp_path: Path, driven) -> None:
    problem = short(name)
    first = compared(problem, tmp_path / "runs")
    assert driven == [(1, 0), (2, 0), (1, 1), (2, 1)] and first.resumed == 0
    again = compared(problem, tmp_path / "runs")
    assert len(driven) == 4 and again.resumed == 4
    assert all(isinstance(run, RunSummary) for run in again.runs)
    assert repr(again.rows) == repr(first.rows)
    for one, other in zip(again.runs, first.runs, strict=True):
        assert study.encoded(one) == study.encoded(other)


def test_only_what_is_missing_is_driven(tmp_path: Path, driven) -> None:
    """More seeds, another horizon, and a run whose record is damaged or of another key."""
    problem, folder = short("open_field"), tmp_path / "runs"
    compared(problem, folder, seeds=1)
    del driven[:]
    assert compared(problem, folder, horizons=(2, 3)).resumed == 1
    assert driven == [(3, 0), (2, 1), (3, 1)]
    del driven[:]
    records = sorted(folder.iterdir())
    assert len(records) == 5
    records[0].write_text(records[0].read_text()[:-40])
    records[1].write_bytes(records[2].read_bytes())
    data = json.loads(records[3].read_text())
    records[3].write_text(json.dumps({**data, "result": {**data["result"], "seed": "0"}}))
    records[4].write_text("[" * 100_000)
    compared(problem, folder, horizons=(1, 2, 3), seeds=2)
    assert len(driven) == 4 + 1
    del driven[:]
    assert compared(problem, folder, horizons=(1, 2, 3), seeds=2).resumed == 6 and not driven


def test_other_processes_keep_their_runs(tmp_path: Path, driven) -> None:
    """The record of workers is that of one process."""
    problem = short("open_field")
    compared(problem, tmp_path / "runs", workers=2)
    assert compared(problem, tmp_path / "runs").resumed == 4 and not driven


def test_what_decides_a_run_is_in_its_key(tmp_path: Path, monkeypatch) -> None:
    """Settings, seed, the content of files wherever they are, and the program; not the pictures."""
    problem = load("munich_courier")
    key = run_key(problem, 0)
    assert key == run_key(load("munich_courier"), 0)
    assert json.loads(json.dumps(key)) == key
    assert key == run_key(replace(problem, report=replace(problem.report, figures=False)), 0)
    assert key != run_key(problem, 1)
    assert key != run_key(replace(problem, planner=replace(problem.planner, horizon=3)), 0)
    station = replace(problem.stations[0], threshold_dbm=-84.0)
    assert key != run_key(replace(problem, stations=(station,)), 0)

    def moved(change: bytes) -> Problem:
        tables = problem_to_dict(problem)
        content = Path(tables["channel"]["truth"]["file"]).read_bytes()
        (tmp_path / "map.npz").write_bytes(content + change)
        tables["channel"]["truth"]["file"] = str(tmp_path / "map.npz")
        return problem_from_tables(tables, folder=tmp_path, file=None)

    assert key == run_key(moved(b""), 0)
    assert key != run_key(moved(b"0"), 0)
    monkeypatch.setattr(study, "program", lambda: (("planopt", "9.9"),))
    assert key != run_key(problem, 0)


def test_remains_of_processes_that_ended_are_removed(tmp_path: Path) -> None:
    """Killed while it keeps a result; a process that still writes is not disturbed."""
    writer = (
        "import os, sys; from pathlib import Path; from planopt.files.writing import write_whole; "
        "write_whole(Path(sys.argv[1]), lambda temporary: (temporary.touch(), os._exit(9)))"
    )
    subprocess.run([sys.executable, "-c", writer, tmp_path / "a.json"], check=False)
    (killed,) = tmp_path.iterdir()
    record = FinishedRuns(tmp_path)

    def write(temporary: Path) -> None:
        temporary.write_text("{}")
        record.tidy()
        assert temporary.exists() and not killed.exists()

    write_whole(tmp_path / "b.json", write)
    assert [path.name for path in tmp_path.iterdir()] == ["b.json"]


def test_records_that_are_no_result(tmp_path: Path) -> None:
    """Missing, of another type, or left between writing and renaming by a killed process."""
    record = FinishedRuns(tmp_path)
    assert record.find({"seed": 1}, float) is None
    record.keep({"seed": 1}, 0.5)
    (kept,) = tmp_path.iterdir()
    assert record.find({"seed": 1}, RunSummary) is None and record.find({"seed": 1}, float) == 0.5
    (tmp_path / f".{kept.stem}-by-1-0a.json").write_bytes(kept.read_bytes())
    assert record.all(float) == [0.5]
