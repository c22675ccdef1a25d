"""The regression suite with networks, pursuits and designs."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import planopt
from planopt.cli import main
from planopt.studies.bench_cases import answer, library_cases, start_of
from planopt.studies.bench_references import read_references, write_references

TASKS = "pursuit_design,pursuit_static,pursuit_obstacles,coverage_plain"


def test_cases_of_every_task() -> None:
    """Deployments and designs have one solver; runs have every planner that suits the problem."""
    cases = library_cases(TASKS.split(","), seeds=[0], run_seeds=[0])
    found = {(case.question.problem, case.question.kind, case.planner) for case in cases}
    assert {case for case in found if case[1] == "plan"} == {
        ("pursuit_design", "plan", "pursuit_design"),
        ("coverage_plain", "plan", "coverage"),
    }
    assert found >= {
        *(("coverage_plain", "run", name) for name in ("law", "receding")),
        *(
            (problem, "run", name)
            for problem in ("pursuit_static", "pursuit_obstacles")
            for name in ("drive", "retarget", "receding")
        ),
    }
    assert len(library_cases(["pursuit_design"], seeds=range(3), run_seeds=range(3))) == 1
    law = library_cases(["coverage_plain"], planners=["law"], seeds=[], run_seeds=[0, 1])
    assert [(case.planner, case.question.seed) for case in law] == [("law", 0), ("law", 1)]


def test_rows_are_those_of_solve_and_simulate() -> None:
    """Objectives are the power of a design and the capture time of a pursuit."""
    (design,) = library_cases(["pursuit_design"], seeds=[0], run_seeds=[])
    row = answer(design, start_of(design))
    data = planopt.solve(planopt.load("pursuit_design")).data
    assert row.objective == data["objective"] and row.accepted and row.verdict == "verified"
    (drive,) = library_cases(["pursuit_static"], planners=["drive"], seeds=[], run_seeds=[3])
    row = answer(drive, start_of(drive))
    data = planopt.simulate(planopt.load("pursuit_static"), seed=3).data
    assert (row.objective, row.sense) == (data["capture_time_s"], "min")
    assert row.termination == "captured" and row.steps == data["metrics"]["steps"]


def test_commands(tmp_path: Path, capsys) -> None:
    out, file = str(tmp_path / "out"), str(tmp_path / "references.json")
    arguments = ["--seeds", "1", "--run-seeds", "1", "--planners", "pursuit_design,drive"]
    problems = ["--problems", "pursuit_design,pursuit_static"]
    assert main(["bench", "run", *problems, *arguments, "--out", out]) == 0
    assert main(["bench", "report", out, "--freeze", file]) == 0
    assert {one.objective for one in read_references(Path(file)).values()} <= {
        one.objective for one in read_references().values()
    }
    capsys.readouterr()
    assert main(["bench", "report", out, "--json"]) == 0
    kinds = json.loads(capsys.readouterr().out)["scores"]
    scores = [score for kind in kinds.values() for score in kind]
    assert [score["success_rate"] for score in scores] == [1.0, 1.0]
    assert all(score["fallback_share"] == 0.0 for score in scores)


def test_a_worse_pursuit_is_a_regression(tmp_path: Path, monkeypatch, capsys) -> None:
    """A capture that takes 2 % longer, and a run that no longer ends with a capture."""
    known = {c: r for c, r in read_references().items() if r.problem == "pursuit_static"}
    file = tmp_path / "references.json"
    check = ["bench", "check", "--problems", "pursuit_static", "--workers", "1"]
    better = {c: replace(r, objective=0.98 * r.objective) for c, r in known.items() if r.objective}
    write_references(better, file)
    assert main([*check, "--references", str(file)]) == 1
    assert "% worse" in capsys.readouterr().out
    assert main(check) == 0
    original = planopt.load

    def short(name):
        problem = original(name)
        rules = problem.config.pursuit.model_copy(update={"max_steps": 20})
        return replace(problem, config=problem.config.model_copy(update={"pursuit": rules}))

    monkeypatch.setattr("planopt.studies.bench_cases.load", short)
    assert main(check) == 1
    assert "verdict none, was verified" in capsys.readouterr().out


@pytest.mark.parametrize("planner", ["law", "receding"])
def test_errors_become_rows(planner: str, monkeypatch) -> None:
    """A simulator that raises fails its own case only."""
    (case,) = library_cases(["coverage_plain"], planners=[planner], seeds=[], run_seeds=[0])
    monkeypatch.setattr("planopt.tasks.task.perform", lambda *_, **__: 1 / 0)
    row = answer(case, start_of(case))
    assert row.outcome == "error" and "ZeroDivisionError" in row.reasons[0]
