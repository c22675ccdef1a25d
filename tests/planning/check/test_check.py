"""The judgement of saved plans and runs from their files alone."""

import csv
import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planopt import load
from planopt.errors import InputError
from planopt.planning.certificate import Certificate
from planopt.planning.check.check import CheckResult, check
from planopt.planning.files.saved import save_run, save_solution, write_result
from planopt.planning.files.solution_json import no_plan_json
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.plan import Rung, Verdict
from planopt.planning.proof.verify import STANDING
from planopt.planning.run import Run
from planopt.planning.search.global_search import GlobalSearch
from planopt.planning.solution import Solution
from planopt.planning.solve import solve


@pytest.fixture(scope="module")
def solution() -> Solution:
    """A verified plan of six steps beside the wall."""
    found = solve(load("open_field"), horizon=6)
    assert found.plan.verdict is Verdict.VERIFIED
    return found


@pytest.fixture(scope="module")
def simulation() -> Run:
    """A run of eight steps, some of which measured."""
    problem = load("open_field")
    return simulate(
        replace(problem, planner=replace(problem.planner, max_steps=8)), horizon=4, seed=1
    )


@pytest.fixture
def plan_folder(tmp_path: Path, solution: Solution) -> Path:
    """The plan, saved."""
    save_solution(solution, tmp_path / "plan")
    return tmp_path / "plan"


@pytest.fixture
def run_folder(tmp_path: Path, simulation: Run) -> Path:
    """The run, saved."""
    save_run(simulation, tmp_path / "run")
    return tmp_path / "run"


def edit_steps(folder: Path, step: int, **cells: str) -> None:
    """Change cells of one row of ``steps.csv``."""
    rows = list(csv.DictReader(io.StringIO((folder / "steps.csv").read_text())))
    rows[step].update(cells)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    (folder / "steps.csv").write_text(text.getvalue())


def edit_json(folder: Path, name: str, change: Callable[[dict], object]) -> None:
    """Change a JSON file."""
    data = json.loads((folder / name).read_text())
    change(data)
    (folder / name).write_text(json.dumps(data))


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


def test_rejects_a_waypoint_in_an_obstacle(plan_folder: Path) -> None:
    """One waypoint moved into the wall, in the table: step and obstacle are named."""
    edit_steps(plan_folder, 3, x_m="30.0", y_m="19.0")
    result = rejected(plan_folder, "step 3", "lies in obstacle wall")
    assert any("robots[0].x_m[3]" in r and "found 30" in r for r in result.reasons)
    assert result.certificate is not None and result.certificate.min_clearance_m == 0.0


def test_rejects_a_waypoint_in_an_obstacle_in_both_files(plan_folder: Path) -> None:
    """A consistent lie about a waypoint is found by geometry alone."""
    edit_steps(plan_folder, 3, x_m="30.0", y_m="19.0")

    def move(data: dict) -> None:
        data["robots"][0]["x_m"][3], data["robots"][0]["y_m"][3] = 30.0, 19.0

    edit_json(plan_folder, "plan.json", move)
    result = rejected(plan_folder, "step 3", "lies in obstacle wall")
    assert not any("x_m[3]" in reason for reason in result.reasons)


def test_rejects_a_way_through_an_obstacle(plan_folder: Path) -> None:
    """Waypoints on both sides of the wall are free, the way between is not."""
    edit_steps(plan_folder, 4, x_m="40.0", y_m="24.0")
    edit_steps(plan_folder, 5, x_m="40.0", y_m="14.0")
    rejected(plan_folder, "step 5", "comes within 0.000 m of obstacle wall")


def test_rejects_positions_that_differ_between_the_files(plan_folder: Path) -> None:
    """Two micrometres between the files are too many; half of one is round-off."""
    x = float(json.loads((plan_folder / "plan.json").read_text())["robots"][0]["x_m"][2])
    edit_steps(plan_folder, 2, x_m=repr(x + 5e-7))
    assert check(plan_folder).verdict is Verdict.VERIFIED
    edit_steps(plan_folder, 2, x_m=repr(x + 2e-6))
    rejected(plan_folder, "plan.json, key robots[0].x_m[2]")


def test_rejects_a_step_too_long(plan_folder: Path) -> None:
    """A waypoint 50 m away cannot be reached in a step."""
    edit_steps(plan_folder, 6, x_m="5.0", y_m="90.0")
    rejected(plan_folder, "speed_max_m_s")


def test_rejects_a_start_elsewhere(plan_folder: Path) -> None:
    """A plan that starts where the robot is not."""
    edit_steps(plan_folder, 0, x_m="31.0")
    rejected(plan_folder, "longer than robots[0].speed_max_m_s")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["certificate"].update(min_clearance_m=9.0), ["certificate.min_clearance_m"]),
        (lambda d: d["certificate"].update(min_clearance_m=None), ["certificate.min_clearance_m"]),
        (lambda d: d["certificate"].update(min_connectivity=1.0), ["certificate.min_connectivity"]),
        (lambda d: d.update(verdict="violated"), ["key verdict", "violated", "found", "verified"]),
        (lambda d: d["problem_file"]["planner"].update(horizon=9), ["planner.horizon is 9"]),
        (lambda d: d["problem_file"]["planner"].update(step_s=3.0), ["steps.csv", "t_s is 2"]),
        (lambda d: d["problem_file"]["constraints"].update(clearance_m=3.0), ["clearance_m is 3"]),
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
        (lambda d: d["robots"][0]["t_s"].__setitem__(2, 0.5), ["robots[0].t_s[2]: 0.5, found 4"]),
    ],
)
def test_rejects_a_claim_that_does_not_hold(
    plan_folder: Path, change: Callable[[dict], object], words: list[str]
) -> None:
    """Whatever the JSON claims of plan or problem that the other files do not bear out."""
    edit_json(plan_folder, "plan.json", change)
    rejected(plan_folder, *words)


def test_rejects_a_prediction_that_the_belief_does_not_give(plan_folder: Path) -> None:
    """The table's power is computed again; an empty cell is no answer."""
    edit_steps(plan_folder, 2, predicted_db="-20.0", deviation_db="")
    rejected(plan_folder, "step 2", "predicted_db is -20")
    rejected(plan_folder, "step 2", "deviation_db is empty")


def test_rejects_measurements_that_were_changed(plan_folder: Path) -> None:
    """Powers that were raised after the plan do not give the saved sites."""
    with np.load(plan_folder / "belief.npz") as archive:
        arrays = dict(archive)
    arrays["power_dbm"] = arrays["power_dbm"] + 1.0
    np.savez(plan_folder / "belief.npz", **arrays)
    rejected(plan_folder, "belief.npz, key power_dbm[0]", "found with seed 0")
    rejected(plan_folder, "belief.npz, key values_db[0]")


def test_a_plan_that_was_not_verified_stays_so(tmp_path: Path) -> None:
    """A threshold that cannot be met: the verifier's own reasons, and no quarrel about them."""
    problem = load("open_field")
    station = replace(problem.stations[0], threshold_dbm=0.0)
    found = solve(replace(problem, stations=(station,)), horizon=2)
    assert found.plan.verdict is Verdict.VIOLATED
    save_solution(found, tmp_path)
    result = check(tmp_path)
    assert result.verdict is Verdict.VIOLATED
    assert result.reasons == found.plan.certificate.reasons


def test_no_plan_is_nothing_to_judge(tmp_path: Path, solution: Solution) -> None:
    """The record of a search that found nothing gets verdict none and says why."""
    data = no_plan_json(solution.problem, 0, "cut off")
    write_result(data, solution.problem, tmp_path / "plan.json")
    result = check(tmp_path)
    assert result.verdict is Verdict.NONE and result.certificate is None
    assert "cut off" in result.reasons[0]


def test_rejects_a_run_that_drove_into_an_obstacle(run_folder: Path) -> None:
    """A driven place moved into the wall; it is no longer what the plan said either."""
    edit_steps(run_folder, 4, x_m="30.0", y_m="19.0")
    rejected(run_folder, "step 4", "lies in obstacle wall")
    rejected(run_folder, "step 4", "not the first step of its plan")


def test_rejects_a_released_plan_that_was_changed(run_folder: Path) -> None:
    """The rest of a plan that was not driven counts as well."""

    def move(data: dict) -> None:
        released = data["plans"][0]["released"][2]
        released["x_m"][4], released["y_m"][4] = 30.0, 19.0

    edit_json(run_folder, "run.json", move)
    result = rejected(run_folder, "the plan for step 3", "lies in obstacle wall")
    assert any(
        'plans[0].released[2].verdict: "verified", found "violated"' in reason
        for reason in result.reasons
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(outcome="reached"), ['outcome: "reached", found "step_limit"']),
        (
            lambda d: d["plans"][0]["released"][1].update(verdict="violated"),
            ["plans[0].released[1].verdict"],
        ),
        (
            lambda d: [d["plans"][0]["released"][1][key].pop() for key in ("x_m", "y_m")],
            ["plans[0].released[1]", "has 3 steps"],
        ),
        (lambda d: d["problem_file"]["robots"][0].update(start_m=[31.0, 40.0]), ["does not start"]),
    ],
)
def test_rejects_a_false_record_of_a_run(
    run_folder: Path, change: Callable[[dict], object], words: list[str]
) -> None:
    """Outcome, verdicts and plans must be those that the other files bear out."""
    edit_json(run_folder, "run.json", change)
    rejected(run_folder, *words)


def test_rejects_a_false_connection(run_folder: Path) -> None:
    """Connected is what the true power says, and nothing else."""
    edit_steps(run_folder, 2, connected="0")
    rejected(run_folder, "row 4, step 2", 'connected is "0", found "1"')


def test_rejects_a_prediction_of_another_belief(run_folder: Path) -> None:
    """Each row is predicted from what was known before it."""
    edit_steps(run_folder, 5, deviation_db="1.0")
    rejected(run_folder, "step 5", "deviation_db is 1")


def test_rejects_a_measurement_from_elsewhere(run_folder: Path) -> None:
    """What was measured on the way was measured where the robot was."""
    with np.load(run_folder / "belief.npz") as archive:
        arrays = dict(archive)
    assert len(arrays["positions_m"]) > arrays["first_measurements"]
    arrays["positions_m"][-1] += 0.5
    np.savez(run_folder / "belief.npz", **arrays)
    rejected(run_folder, "belief.npz, key positions_m")


def test_a_run_of_no_step(tmp_path: Path) -> None:
    """Starting at the goal is a run that there is nothing to say against."""
    problem = load("open_field")
    robot = replace(problem.robots[0], start_m=problem.robots[0].goal_m)
    save_run(simulate(replace(problem, robots=(robot,))), tmp_path)
    result = check(tmp_path)
    assert result.verdict is Verdict.VERIFIED and result.certificate is None


def test_the_certificate_of_a_run_is_its_worst() -> None:
    """Each number is the worst over the steps; a driven step that missed the bound is listed."""
    first = Certificate(2.0, 0.9, 1e-9, None, "exact")
    second = Certificate(1.6, 0.7, 1e-7, 1e-6, "exact", (1, 2), (0.4, 0.3), (-0.2, -0.1))
    third = Certificate(1.8, 0.95, 0.0, 1e-8, "exact", (3,), (0.1,), (-0.05,))
    worst = CheckResult(Verdict.VERIFIED, (first, second, third), ()).certificate
    assert worst == Certificate(1.6, 0.7, 1e-7, 1e-6, "exact", (2,), (0.4,), (-0.2,))


def test_an_easier_bound_is_remarked_upon(plan_folder: Path) -> None:
    """Who lowers p_min asked another question: the plan answers it, and the difference is said."""
    edit_json(
        plan_folder,
        "plan.json",
        lambda d: d["problem_file"]["constraints"].update(p_min=0.5),
    )
    result = check(plan_folder)
    assert result.verdict is Verdict.VERIFIED
    assert result.remarks == (
        "plan.json, key problem_file.constraints.p_min: 0.5, in the library's open_field 0.8",
    )


def test_a_harder_bound_is_rejected(plan_folder: Path) -> None:
    """A plan that says it is verified must keep the bound that stands beside it."""
    edit_json(
        plan_folder,
        "plan.json",
        lambda d: d["problem_file"]["constraints"].update(p_min=0.9999),
    )
    rejected(plan_folder, "plan.json, key certificate.relaxed_steps: 0 values, found 2 values")
    rejected(plan_folder, "plan.json, key message", "miss the connectivity bound")


def test_a_bound_that_nobody_proved_is_rejected(plan_folder: Path) -> None:
    """Neither bound nor gap can be made up, not even so that they fit."""
    edit_json(plan_folder, "plan.json", lambda d: d.update(bound=d["objective"], gap=0.0))
    rejected(plan_folder, "plan.json, key bound", "found null")
    rejected(plan_folder, "plan.json, key gap: 0, found null")


def test_a_truth_that_is_not_to_be_had(run_folder: Path) -> None:
    """Without the map there is nothing to compare true powers with, but each other."""

    def lose(data: dict) -> None:
        data["problem_file"]["channel"]["truth"] = {
            "kind": "raster",
            "file": "gone.npz",
            "variable": "gain_db",
            "floor_db": -150.0,
        }

    edit_json(run_folder, "run.json", lose)
    result = check(run_folder)
    assert result.verdict is Verdict.VERIFIED
    assert any("cannot be drawn again" in r and "gone.npz" in r for r in result.remarks)
    edit_steps(run_folder, 1, true_db="-90.0")
    rejected(run_folder, "row 3, step 1", 'connected is "1", found "0"')
    rejected(run_folder, "belief.npz, key power_dbm")


def test_measurements_of_the_way_that_are_missing(run_folder: Path) -> None:
    """Nor can they be left out where there is no truth to take them from."""
    test_a_truth_that_is_not_to_be_had(run_folder)
    with np.load(run_folder / "belief.npz") as archive:
        arrays = dict(archive)
    first = int(arrays["first_measurements"])
    for name in ("positions_m", "power_dbm", "censored", "values_db", "noise_variance_db2"):
        arrays[name] = arrays[name][:first]
    for name in ("resolution_db", "position_std_m", "time_s", "receiver"):
        arrays[name] = arrays[name][:first]
    arrays["known_before_step"][:] = first
    np.savez(run_folder / "belief.npz", **arrays)
    rejected(run_folder, "belief.npz, key known_before_step")
    rejected(run_folder, f"belief.npz, key censored: {first} values")


def test_first_measurements_that_cannot_be_fitted(plan_folder: Path) -> None:
    """Measurements that were all moved to one place are rejected, not an error."""
    with np.load(plan_folder / "belief.npz") as archive:
        arrays = dict(archive)
    arrays["first_measurements"] = np.array(0)
    np.savez(plan_folder / "belief.npz", **arrays)
    rejected(plan_folder, "belief.npz", "first 0 measurements")


def test_a_run_that_was_cut_short(run_folder: Path) -> None:
    """A run ends for a reason: the last step cannot be left out of all files."""

    def cut(data: dict) -> None:
        data["plans"][0]["released"].pop()
        for column in ("t_s", "x_m", "y_m", "connectivity"):
            data["robots"][0][column].pop()

    edit_json(run_folder, "run.json", cut)
    text = (run_folder / "steps.csv").read_text()
    (run_folder / "steps.csv").write_text(text[: text.rstrip().rfind("\n") + 1])
    with np.load(run_folder / "belief.npz") as archive:
        arrays = dict(archive)
    arrays["known_before_step"] = arrays["known_before_step"][:-1]
    np.savez(run_folder / "belief.npz", **arrays)
    rejected(run_folder, "the run ends after step 7", "max_steps is 8")


def test_a_run_that_goes_on_after_its_end(run_folder: Path) -> None:
    """Two steps past the limit that stands beside it."""
    edit_json(run_folder, "run.json", lambda d: d["problem_file"]["planner"].update(max_steps=6))
    rejected(run_folder, "the run ends after step 8, planner.max_steps is 6")


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ({"p50": 2.0, "p95": 1.0, "max": 3.0}, "out of order"),
        ({"p50": None, "p95": None, "max": None}, "0 values for 8 steps"),
        ({"p50": 0.1, "p95": None, "max": 0.2}, "2 values for 8 steps"),
    ],
)
def test_step_times_have_an_order(run_folder: Path, times: dict, words: str) -> None:
    """They cannot be measured again; that they are quantiles can be seen."""
    edit_json(run_folder, "run.json", lambda d: d.update(step_s=times))
    rejected(run_folder, "run.json, key step_s", words)


@pytest.mark.parametrize(
    ("times", "words"),
    [({"wall_s": 0.0}, "but wall_s is 0"), ({"solve_s": 0.0}, "but the termination is converged")],
)
def test_solving_takes_a_part_of_planning(plan_folder: Path, times: dict, words: str) -> None:
    """Its time is neither more than the whole nor nothing."""
    edit_json(plan_folder, "plan.json", lambda d: d["robots"][0].update(times))
    rejected(plan_folder, "plan.json, key robots[0].solve_s", words)


def test_a_record_of_no_plan_must_be_one(tmp_path: Path, solution: Solution) -> None:
    """It has no objective."""
    data = no_plan_json(solution.problem, 0, "cut off")
    write_result({**data, "objective": 3.0}, solution.problem, tmp_path / "plan.json")
    assert "plan.json, key objective: 3, found null" in check(tmp_path).reasons


def test_plan_and_run_in_one_folder(plan_folder: Path, run_folder: Path) -> None:
    """Nobody can tell which of them the other files belong to."""
    (run_folder / "run.json").replace(plan_folder / "run.json")
    with pytest.raises(InputError, match="both there"):
        check(plan_folder)


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


def test_a_plan_that_stops_where_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no lattice node is in reach there is no way beyond the horizon to charge."""
    monkeypatch.setattr(GlobalSearch, "find_start", lambda *_: None)
    found = solve(load("open_field"), horizon=3)
    assert found.plan.rung is Rung.STOP and found.plan.pivot is None
    save_solution(found, tmp_path)
    assert found.plan.verdict is Verdict.FEASIBLE_UNVERIFIED
    assert check(tmp_path).reasons == (STANDING,)
    edit_json(tmp_path, "plan.json", lambda d: d["robots"][0].update(rung="plan"))
    rejected(tmp_path, "plan.json, key robots[0].pivot: null, but the rung is plan")


def test_a_run_saved_before_it_listed_excused_steps(run_folder: Path) -> None:
    """Keys that came later may be missing; where they are there they must be right."""
    file = run_folder / "run.json"
    data = json.loads(file.read_text())
    data["plans"][0]["released"][2]["relaxation_db"] = [0.5]
    file.write_text(json.dumps(data))
    rejected(run_folder, "run.json, key plans[0].released[2].relaxation_db: 1 values")
    for released in data["plans"][0]["released"]:
        del released["relaxation_db"], released["best_margin_db"]
    del data["robots"][0]["excused"]
    file.write_text(json.dumps(data))
    assert check(run_folder).reasons == ()
