"""``planopt bench``: runs that go on, reports, frozen references, and the check of regressions."""

import csv
import hashlib
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from refusals import expect_message, refused_command

from planopt import load, solve
from planopt.cli import main
from planopt.extend import PlannerKind, Rung, Termination, register_planner
from planopt.planning.candidates import held
from planopt.problems.library import find_problem
from planopt.studies import bench_cases, study
from planopt.studies.bench_references import read_references, write_references
from planopt.tasks.motion import MotionTask

CHECK = ["bench", "check", "--problems"]
RUN = ["bench", "run", "--seeds", "1", "--run-seeds", "0", "--horizons", "2"]


def ran(folder: Path, *more: str, problems: str = "outdoor_map") -> int:
    return main(
        [*RUN, "--problems", problems, "--planners", "auto,lattice", *more, "--out", str(folder)]
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bench") / "out"
    assert ran(out) == 0
    return out


@pytest.fixture
def answered(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Planners of the cases that are answered in this process, not taken from the record."""
    seen: list[str] = []
    original = MotionTask.answer

    def counted(task, problem, *more):
        seen.append(problem.planner.name)
        return original(task, problem, *more)

    monkeypatch.setattr(MotionTask, "answer", counted)
    return seen


def test_rows_have_what_was_found(folder: Path) -> None:
    """The table is of the plan that ``planopt solve`` gives."""
    with (folder / "rows.csv").open() as file:
        auto, lattice = csv.DictReader(file)
    assert (auto["planner"], lattice["planner"]) == ("auto", "lattice")
    plan = solve(load("outdoor_map"), horizon=2).plan
    assert float(auto["objective"]) == plan.objective
    assert auto["verdict"] == "verified" == lattice["verdict"]
    assert auto["termination"] == plan.termination.value
    assert lattice["termination"] == "lattice_only" and lattice["iterations"] == "0"
    assert int(auto["iterations"]) == plan.iterations
    assert auto["accepted"] == "True" and auto["sense"] == "max"
    assert float(auto["min_connectivity"]) == plan.certificate.min_connectivity
    millimetres = (np.round(plan.positions_m, 3) + 0.0).tobytes()
    assert auto["path_digest"] == hashlib.sha256(millimetres).hexdigest()[:16]


@pytest.mark.parametrize("seconds", ["nan", "inf", "1e9"])
def test_a_proof_needs_a_time(seconds: str, tmp_path: Path, capsys) -> None:
    """A time that is not finite or is above 1e6 s is rejected before a case is solved."""
    assert ran(tmp_path / "out", "--prove", seconds, problems="no_route_gap") == 2
    expect_message(capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_again_answers_nothing(folder: Path, answered: list[str], capsys) -> None:
    """And adds what is new; damaged rows are answered again."""
    before = (folder / "rows.csv").read_text()
    assert ran(folder) == 0 and answered == []
    assert (folder / "rows.csv").read_text() == before
    capsys.readouterr()
    assert ran(folder, "--planners", "lattice,one_step", "--json") == 0
    assert answered == ["one_step"] and json.loads(capsys.readouterr().out)["rows"] == 2
    for file in (folder / "rows").iterdir():
        file.write_text(file.read_text()[:-20])
    del answered[:]
    assert ran(folder) == 0 and answered == ["auto", "lattice"]


def test_another_program_is_refused(folder: Path, monkeypatch, capsys) -> None:
    """Rows of two programs could not be compared; the message names both."""
    made = dict(study.program())

    monkeypatch.setattr(
        "planopt.studies.bench_cases.program", lambda: tuple({**made, "planopt": "9.9"}.items())
    )
    assert ran(folder) == 2
    assert f"planopt {made['planopt']}, this is 9.9" in capsys.readouterr().err


def test_another_problem_is_refused(tmp_path: Path, capsys) -> None:
    """A problem file that was edited since; other problems may join."""
    file = tmp_path / "mine.toml"
    text = find_problem("outdoor_map").read_text()
    file.write_text(text)
    assert ran(tmp_path / "out", problems=str(file)) == 0
    assert ran(tmp_path / "out", problems=f"{file},outdoor_map") == 0
    file.write_text(text.replace("max_steps = ", "max_steps = 1"))
    capsys.readouterr()
    assert ran(tmp_path / "out", problems=str(file)) == 2
    expect_message(capsys.readouterr().err)


def test_report(folder: Path, capsys) -> None:
    """Text, JSON, Markdown and a page, with what made the numbers."""
    assert ran(folder) == 0
    capsys.readouterr()
    assert main(["bench", "report", str(folder), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data == json.loads((folder / "report.json").read_text())
    assert data["program"]["planopt"] and data["cpu"] and data["tolerances"]["objective_share"]
    assert {score["planner"] for score in data["scores"]["plan"]} >= {"auto", "lattice"}
    assert data["profiles"]["plan"]["ratios"][0] == 1.0
    assert "<title>Planners in the regression suite" in (folder / "report.html").read_text()
    assert main(["bench", "report", str(folder), "--no-page"]) == 0
    words = capsys.readouterr().out
    assert "auto" in words and "tolerances:" not in words
    written = (folder / "report.md").read_text()
    assert "tolerances:" in written and "casadi" in written and "## Questions" in written
    assert "## Questions" not in words
    assert not (folder / "report.html").exists()


def test_bounds_are_proven_on_request(tmp_path: Path) -> None:
    """A route has a bound below its cost, mapped information one above its value."""
    assert ran(tmp_path, "--prove", "0.5", problems="open_field,outdoor_map") == 0
    with (tmp_path / "rows.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if row["problem"] == "outdoor_map":
            assert float(row["bound"]) >= float(row["objective"]) and float(row["gap"]) >= 0.0
        elif row["cost_to_go"] == "connected":
            assert 50.0 < float(row["bound"]) < float(row["objective"])
            assert 0.0 < float(row["gap"]) < 0.2
        assert row["late"] == "0"
    file = tmp_path / "references.json"
    assert main(["bench", "report", str(tmp_path), "--freeze", str(file)]) == 0
    known = read_references(file)
    assert {one.problem for one in known.values() if one.bound} == {"open_field", "outdoor_map"}


def test_rows_with_impossible_numbers(tmp_path: Path, capsys) -> None:
    """Are left out of a report, like damaged ones."""
    out = tmp_path / "out"
    assert ran(out, "--planners", "auto,lattice,one_step") == 0
    first, second, _ = sorted((out / "rows").iterdir())
    for file, change in ((first, {"objective": "nan"}), (second, {"cpu_s": -1.0})):
        data = json.loads(file.read_text())
        file.write_text(json.dumps({**data, "result": {**data["result"], **change}}))
    (out / "rows" / "other.json").write_text("[" * 100_000)
    capsys.readouterr()
    assert main(["bench", "report", str(out), "--no-page", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rows"] == 1
    (out / "bench.json").write_text('{"program": 3}')
    refused_command(capsys, "bench", "report", out)


def test_freeze_does_not_overwrite_silently(folder: Path, tmp_path: Path, capsys) -> None:
    """New cases are added; a changed one needs --replace and is printed."""
    file = tmp_path / "references.json"
    freeze = ["bench", "report", str(folder), "--freeze", str(file)]
    assert ran(folder) == 0 and main(freeze) == 0 and main(freeze) == 0
    made = read_references(file)
    case = next(case for case in made if case.planner == "auto")
    write_references({**made, case: replace(made[case], objective=1.0)}, file)
    before = file.read_text()
    capsys.readouterr()
    refused_command(capsys, *freeze)
    assert file.read_text() == before
    assert main([*freeze, "--replace"]) == 0
    assert "objective 1.0 -> " in capsys.readouterr().out
    assert read_references(file) == made


@pytest.fixture
def share(tmp_path: Path) -> Path:
    known = {c: r for c, r in read_references().items() if r.problem == "outdoor_map"}
    file = tmp_path / "references.json"
    write_references(known, file)
    return file


def checked(file: Path) -> int:
    """The check of one problem against a file of references."""
    return main([*CHECK, "outdoor_map", "--workers", "1", "--references", str(file)])


def test_check_passes(share: Path, capsys) -> None:
    assert checked(share) == 0
    assert "as good as the references" in capsys.readouterr().out


@pytest.mark.parametrize("kernels", ["Haswell", "Nehalem", "SkylakeX"])
def test_check_passes_on_other_processors(kernels: str) -> None:
    """Rounding differs between the kernels of OpenBLAS; plans from recorded states do not."""
    code = "import sys; from planopt.cli import main; sys.exit(main())"
    problems = "fig2,indoor_learn,outdoor_map,coverage_obstacles,pursuit_obstacles"
    done = subprocess.run(
        [sys.executable, "-c", code, *CHECK, problems, "--workers", "1"],
        env={**os.environ, "OPENBLAS_CORETYPE": kernels},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", ["open_field", "two_station_courier"])
def test_slightly_worse_closed_loop_is_seen(name: str, monkeypatch, tmp_path, capsys) -> None:
    """Robots that drive 3 % slower than they may are a regression of the plans in a closed loop."""
    known = {c: r for c, r in read_references().items() if r.problem == name and r.kind == "run"}
    file = tmp_path / "references.json"
    write_references(known, file)
    original = bench_cases.problem_of

    def slower(case):
        problem = original(case)
        robots = [replace(one, speed_max_m_s=0.97 * one.speed_max_m_s) for one in problem.robots]
        return replace(problem, robots=tuple(robots))

    monkeypatch.setattr(bench_cases, "problem_of", slower)
    assert main([*CHECK, name, "--workers", "1", "--references", str(file)]) == 1
    assert f"worse: {name}, run" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda one: {"objective": 1.05 * one.objective}, "% worse"),
        (lambda one: {"outcome": "no_plan"}, "outcome planned, was no_plan"),
        (lambda one: {"horizon": one.horizon + 1}, "no reference with its own settings"),
    ],
)
def test_check_fails_in_words(share: Path, change, words: str, capsys) -> None:
    """A mutated reference is a regression: exit code 1, and which number it is."""
    known = read_references(share)
    changed = {
        case: replace(one, **change(one))
        for case, one in known.items()
        if case.planner == "auto" and one.kind == "plan"
    }
    kept = {one.case: one for one in changed.values()}
    write_references(kept, share)
    assert checked(share) == 1
    assert words in capsys.readouterr().out


def test_a_rejected_plan_and_an_error_fail(share: Path, monkeypatch, capsys) -> None:
    """A check that objects is a regression; so is a planner that raises, and the rest goes on."""
    forged = SimpleNamespace(verdict=None, reasons=("forged",))
    monkeypatch.setattr(MotionTask, "check", lambda *_: forged)
    assert checked(share) == 1
    assert "the check from its files rejects it (forged)" in capsys.readouterr().out

    def broken(*_):
        raise ZeroDivisionError("no")

    monkeypatch.setattr("planopt.planning.solve.solve_on", broken)
    assert checked(share) == 1
    assert "outcome error, was planned (ZeroDivisionError: no)" in capsys.readouterr().out


class Liar:
    """Stands still, and says that this is an optimum."""

    def __init__(self, problem, ground, generator) -> None:
        pass

    def plan(self, context, scorer, warm=None):
        path = held(context, [])
        found = scorer.assessed(scorer.candidate(path, Rung.PLAN, Termination.CONVERGED))
        return scorer.plan_from(replace(found, solve_s=1e-4), wall_s=1e-3)


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_planner_from_outside(tmp_path: Path, workers: str, capsys, own_parts) -> None:
    """It is solved, checked and scored like planopt's own, in workers as well; lies are seen."""
    register_planner(PlannerKind("liar", Liar))
    names = ["--planners", "auto,liar", "--workers", workers]
    assert ran(tmp_path, *names, problems="outdoor_map,indoor_learn") == 0
    capsys.readouterr()
    assert main(["bench", "report", str(tmp_path), "--json", "--no-page"]) == 0
    own, liar = json.loads(capsys.readouterr().out)["scores"]["plan"]
    assert (own["planner"], own["success_rate"], own["correct_rate"]) == ("auto", 1.0, 1.0)
    assert liar["planner"] == "liar" and liar["verified_rate"] == 1.0
    assert liar["success_rate"] == 0.0 and liar["correct_rate"] == 0.0
