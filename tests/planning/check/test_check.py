"""The judgement of saved plans and runs from their files alone."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planopt import (
    InputError,
    Run,
    Solution,
    Verdict,
    check,
    explain,
    load,
    load_result,
    simulate,
    solve,
)
from planopt.extend import Rung
from planopt.planning.certificate import Certificate
from planopt.planning.check import check as module
from planopt.planning.check.check import CheckResult, library_remarks
from planopt.planning.files.result_json import no_plan_json
from planopt.planning.proof.verify import STANDING
from planopt.planning.search.global_search import GlobalSearch
from planopt.problems import ArrayTruth
from planopt.problems.load import with_overrides
from planopt.tasks.motion import NoPlan


def edit_json(folder: Path, name: str, change: Callable[[dict], object]) -> None:
    data = json.loads((folder / name).read_text())
    change(data)
    (folder / name).write_text(json.dumps(data))


def edit_text(folder: Path, name: str, old: str, new: str) -> None:
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))


def edit_belief(folder: Path, **changes: Any) -> None:
    with np.load(folder / "belief.npz") as archive:
        arrays = dict(archive)
    np.savez(folder / "belief.npz", **arrays | changes)


def rejected(folder: Path, *words: str) -> CheckResult:
    """The check's result, which must object, with all `words` in one of the reasons."""
    result = check(folder)
    assert result.verdict is Verdict.VIOLATED
    assert any(all(word in reason for word in words) for reason in result.reasons), result.reasons
    return result


def test_agrees_with_a_saved_plan(plan_folder: Path, solution: Solution) -> None:
    """The certificate computed from the files is the planner's own, to the last bit."""
    result = check(plan_folder)
    assert result.verdict is Verdict.VERIFIED and result.reasons == ()
    assert result.certificate == solution.plan.certificate


def test_agrees_with_a_saved_run(run_folder: Path, simulation: Run) -> None:
    """Every released plan is judged again on what was believed at its time."""
    result = check(str(run_folder))
    assert result.verdict is Verdict.VERIFIED and result.reasons == ()
    assert list(result.certificates) == [plan.certificate for plan in simulation.plans[0]]


def move(x: int, y: int, *steps: int) -> Callable[[dict], None]:
    """Put waypoints of the plan somewhere else."""

    def change(data: dict) -> None:
        for step in steps:
            data["robots"][0]["x_m"][step], data["robots"][0]["y_m"][step] = float(x), float(y)

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (move(30, 19, 3), ["step 3", "lies in obstacle wall"]),
        (move(40, 24, 4), ["step 5", "comes within", "of obstacle wall"]),
        (move(5, 90, 6), ["speed_max_m_s"]),
        (move(31, 40, 0), ["robots[0].x_m[0]: 31, recomputed 32"]),
        (
            lambda d: d["certificate"].update(min_clearance_m=9.0),
            ["min_clearance_m: 9, recomputed"],
        ),
        (lambda d: d["certificate"].update(min_clearance_m=None), ["certificate.min_clearance_m"]),
        (lambda d: d["certificate"].update(min_connectivity=1.0), ["certificate.min_connectivity"]),
        (
            lambda d: d.update(verdict="violated"),
            ["key verdict", "violated", "recomputed", "verified"],
        ),
        (lambda d: d.update(bound=d["objective"]), ["plan.json, key bound", "recomputed null"]),
        (lambda d: d.update(optimal=True), ["key optimal: true, recomputed no such key"]),
        (lambda d: d.pop("gap"), ["key gap: is missing"]),
        (lambda d: d.update(seed=4), ["found with seed 4"]),
        (lambda d: d["problem_file"]["planner"].update(step_s=3.0), ["steps.csv", "t_s: 2"]),
        (lambda d: d["problem_file"]["constraints"].update(clearance_m=3.0), ["clearance_m is 3"]),
        (
            lambda d: d["problem_file"]["constraints"].update(p_min=0.9999),
            ["certificate.relaxed_steps: 0 values, recomputed 2 values"],
        ),
        (
            lambda d: d["problem_file"]["stations"][0].update(threshold_dbm=20.0),
            ["constraints.p_min", "met nowhere"],
        ),
        (
            lambda d: d["problem_file"]["stations"][0].update(height_m=9.0),
            ["belief.npz, key station"],
        ),
        (
            lambda d: d["robots"][0]["connectivity"].__setitem__(2, 0.5),
            ["robots[0].connectivity[2]: 0.5"],
        ),
        (
            lambda d: d["robots"][0]["t_s"].__setitem__(2, 0.5),
            ["robots[0].t_s[2]: 0.5, recomputed 4"],
        ),
    ],
)
def test_rejects_a_plan_that_does_not_hold(
    plan_folder: Path, change: Callable[[dict], object], words: list[str]
) -> None:
    """Whatever the JSON claims that the replay does not bear out."""
    edit_json(plan_folder, "plan.json", change)
    rejected(plan_folder, *words)


def test_positions_agree_between_the_files(plan_folder: Path) -> None:
    """Two micrometres between the files are too many; half of one is round-off."""
    x = json.loads((plan_folder / "plan.json").read_text())["robots"][0]["x_m"][2]
    edit_text(plan_folder, "steps.csv", repr(x), repr(x + 5e-7))
    assert check(plan_folder).verdict is Verdict.VERIFIED
    edit_text(plan_folder, "steps.csv", repr(x + 5e-7), repr(x + 2e-6))
    rejected(plan_folder, "steps.csv, row 4, key x_m")


def test_what_only_planning_can_find_is_covered_by_the_digest(tmp_path: Path) -> None:
    """Explanations, crossings and the rest of the way are those that were saved."""
    problem = load("open_field")
    deaf = replace(problem, stations=(replace(problem.stations[0], threshold_dbm=-23.0),))
    found = solve(deaf, horizon=2)
    replace(found, explanation=explain(found)).save(tmp_path)
    data = json.loads((tmp_path / "plan.json").read_text())
    assert data["explanation"]
    assert not any("digest" in reason for reason in check(tmp_path).reasons)
    back = load_result(tmp_path)
    assert isinstance(back, Solution) and len(back.explanation) == len(data["explanation"])
    for change in (
        lambda d: d["explanation"][0].update(shortfall=0.5),
        lambda d: d["crossings"].append({"robot": "r", "cost_m": 1, "kept_m": 2, "outside_m": 1}),
        lambda d: d["robots"][0]["route"]["x_m"].__setitem__(1, 4.0),
    ):
        (tmp_path / "plan.json").write_text(json.dumps(data))
        edit_json(tmp_path, "plan.json", change)
        rejected(tmp_path, "plan.json, key digest")


def test_an_easier_bound_is_remarked_upon(plan_folder: Path) -> None:
    """Who lowers p_min asked another question: the plan answers it, and the difference is said."""
    edit_json(
        plan_folder, "plan.json", lambda d: d["problem_file"]["constraints"].update(p_min=0.5)
    )
    result = check(plan_folder)
    assert result.verdict is Verdict.VERIFIED
    assert result.remarks == (
        "plan.json, key problem_file.constraints.p_min: 0.5, in the library's open_field 0.8",
    )


def test_a_plan_that_was_not_verified_stays_so(tmp_path: Path) -> None:
    """A threshold that cannot be met: the verifier's own reasons, and no quarrel about them."""
    problem = load("open_field")
    station = replace(problem.stations[0], threshold_dbm=0.0)
    found = solve(replace(problem, stations=(station,)), horizon=2)
    assert found.plan.verdict is Verdict.VIOLATED
    found.save(tmp_path)
    result = check(tmp_path)
    assert result.verdict is Verdict.VIOLATED
    assert result.reasons == found.plan.certificate.reasons


def test_a_plan_that_stops_where_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no lattice node is in reach there is no way beyond the horizon to charge."""
    monkeypatch.setattr(GlobalSearch, "find_start", lambda *_: None)
    found = solve(load("open_field"), horizon=3)
    assert found.plan.rung is Rung.STOP and found.plan.pivot is None
    found.save(tmp_path)
    assert found.plan.verdict is Verdict.FEASIBLE_UNVERIFIED
    assert check(tmp_path).reasons == (STANDING,)


def test_a_record_of_no_plan(tmp_path: Path, solution: Solution) -> None:
    """It gets verdict none and says why; it has no objective."""
    data = no_plan_json(solution.problem, 0, "cut off")
    NoPlan(solution.problem, (), data, "plan.json", dict).save(tmp_path)
    result = check(tmp_path)
    assert result.verdict is Verdict.NONE and result.certificate is None
    assert result.reasons == ("there is no plan to verify: cut off",)
    NoPlan(solution.problem, (), {**data, "objective": 3.0}, "plan.json", dict).save(tmp_path)
    assert "plan.json, key objective: 3, recomputed null" in check(tmp_path).reasons


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(outcome="reached"), ['outcome: "reached", recomputed "step_limit"']),
        (
            lambda d: d["plans"][0]["released"][1].update(verdict="violated"),
            ["plans[0].released[1].verdict"],
        ),
        (
            lambda d: d["plans"][0]["released"][2].update(
                {key: [30.0 if key == "x_m" else 19.0] * 5 for key in ("x_m", "y_m")}
            ),
            ["the plan for step 3", "lies in obstacle wall"],
        ),
        (
            lambda d: d["plans"][0]["released"][2]["x_m"].__setitem__(4, 47.00001),
            ["run.json, key digest"],
        ),
        (
            lambda d: d["problem_file"]["robots"][0].update(start_m=[31.0, 40.0]),
            ["steps.csv, row 2, key x_m: 32, recomputed 31"],
        ),
        (
            lambda d: d["problem_file"]["planner"].update(max_steps=6),
            ["the run goes on after step 6"],
        ),
        (lambda d: d["plans"][0]["released"].pop(), ["the run ends after step 7", "is 8"]),
    ],
)
def test_rejects_a_run_that_does_not_hold(
    run_folder: Path, change: Callable[[dict], object], words: list[str]
) -> None:
    """Outcome, verdicts and plans must be those of the replay."""
    edit_json(run_folder, "run.json", change)
    rejected(run_folder, *words)


def test_runs_that_are_not_read(run_folder: Path, plan_folder: Path) -> None:
    """A run whose last plans are gone, and a folder with a plan and a run."""
    edit_json(run_folder, "run.json", lambda d: d["plans"][0]["released"].pop())
    with pytest.raises(InputError, match="the run ends after step 7"):
        load_result(run_folder)
    (run_folder / "run.json").replace(plan_folder / "run.json")
    with pytest.raises(InputError, match="has both"):
        check(plan_folder)


def test_a_run_of_no_step(tmp_path: Path) -> None:
    """Starting at the goal is a run that there is nothing to say against."""
    problem = load("open_field")
    robot = replace(problem.robots[0], start_m=problem.robots[0].goal_m)
    simulate(replace(problem, robots=(robot,))).save(tmp_path)
    result = check(tmp_path)
    assert result.verdict is Verdict.VERIFIED and result.certificate is None


def test_the_certificate_of_a_run_is_its_worst() -> None:
    """Each number is the worst over the steps; a driven step that missed the bound is listed."""
    first = Certificate(2.0, 0.9, 1e-9, None, "exact")
    second = Certificate(1.6, 0.7, 1e-7, 1e-6, "exact", (1, 2), (0.4, 0.3), (-0.2, -0.1))
    third = Certificate(1.8, 0.95, 0.0, 1e-8, "exact", (3,), (0.1,), (-0.05,))
    worst = CheckResult(Verdict.VERIFIED, (first, second, third), ()).certificate
    assert worst == Certificate(1.6, 0.7, 1e-7, 1e-6, "exact", (2,), (0.4,), (-0.2,))


def test_a_truth_that_is_not_to_be_had(run_folder: Path) -> None:
    """Without the map true powers and measurements are those of the files."""

    def lose(data: dict) -> None:
        data["problem_file"]["channel"]["truth"] = {
            "kind": "raster",
            "file": "gone.npz",
            "variable": "gain_db",
            "floor_db": -150.0,
        }

    edit_json(run_folder, "run.json", lose)
    result = check(run_folder)
    assert result.verdict is Verdict.VERIFIED, result.reasons
    assert any("gone.npz" in remark for remark in result.remarks)
    cells = (run_folder / "steps.csv").read_text().splitlines()[2].split(",")
    edit_text(run_folder, "steps.csv", cells[8], "-90.0")
    rejected(run_folder, "steps.csv, row 3, key connected")


@pytest.mark.parametrize("given", ["measurements", "truth and measurements"])
def test_a_run_on_given_measurements(given: str, tmp_path: Path, simulation: Run) -> None:
    """They are those of the file; the truth is drawn again where the problem has one."""
    problem = simulation.problem
    if given != "measurements":
        raster = simulation.truths[0].raster
        truth = ArrayTruth(x_m=raster.x_m, y_m=raster.y_m, power_dbm=raster.values)
        problem = replace(problem, channel=replace(problem.channel, truth=truth))
    simulate(problem, measurements=simulation.belief.posterior.measurements).save(tmp_path)
    result = check(tmp_path)
    assert result.verdict is Verdict.VERIFIED, result.reasons
    assert any("first measurements are taken from the file" in text for text in result.remarks)
    assert isinstance(load_result(tmp_path), Run)


def test_first_measurements_that_cannot_be_fitted(run_folder: Path) -> None:
    """A file without any is rejected, not an error."""
    edit_json(
        run_folder,
        "run.json",
        lambda d: d["problem_file"]["channel"]["measurements"].update(count=0),
    )
    edit_belief(run_folder, first_measurements=np.array(0))
    rejected(run_folder, "belief.npz", "cannot be fitted again")


def test_another_task_is_not_judged(plan_folder: Path) -> None:
    """A plan to reach a goal is not passed off as one that learns."""

    def learn_instead(data: dict) -> None:
        tables = data["problem_file"]
        tables["problem"]["task"] = "learn"
        del tables["robots"][0]["goal_m"], tables["constraints"]["goal_radius_m"]
        tables["objective"] = {"terms": [{"kind": "path_loss_learning"}]}

    edit_json(plan_folder, "plan.json", learn_instead)
    rejected(plan_folder, "plan.json, key robots[0].pivot", "no such key")
    rejected(plan_folder, "plan.json, key sense")


def test_remarks_on_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """Overrides are no difference; another name and an unreadable library are remarked on."""
    problem = load("open_field")
    changed = with_overrides(problem, horizon=3, planner="lattice", cost_to_go="geodesic")
    assert library_remarks("plan.json", problem) == library_remarks("plan.json", changed) == []
    (remark,) = library_remarks("plan.json", replace(problem, name="my_field"))
    assert "problem.name: my_field is not in the library" in remark

    def fail(_: object) -> None:
        raise InputError("is damaged")

    problem = load("open_field")
    monkeypatch.setattr(module, "load_motion", fail)
    (remark,) = library_remarks("plan.json", problem)
    assert "cannot be compared with the library's: is damaged" in remark
