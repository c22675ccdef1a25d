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
from planopt.planning.check import CheckResult, check
from planopt.planning.closed_loop import simulate
from planopt.planning.plan import Certificate, Verdict
from planopt.planning.saved import save_record, save_simulation, save_solution
from planopt.planning.simulation import Simulation
from planopt.planning.solution import Solution
from planopt.planning.solution_json import no_plan_json
from planopt.planning.solve import solve


@pytest.fixture(scope="module")
def solution() -> Solution:
    """A verified plan of six steps beside the wall."""
    found = solve(load("open_field"), horizon=6)
    assert found.plan.verdict is Verdict.VERIFIED
    return found


@pytest.fixture(scope="module")
def simulation() -> Simulation:
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
def run_folder(tmp_path: Path, simulation: Simulation) -> Path:
    """The run, saved."""
    save_simulation(simulation, tmp_path / "run")
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


def test_agrees_with_a_saved_run(run_folder: Path, simulation: Simulation) -> None:
    """Every released plan is judged again on what was believed at its time."""
    result = check(str(run_folder))
    assert result.verdict is Verdict.VERIFIED and result.reasons == ()
    assert list(result.certificates) == [plan.certificate for plan in simulation.plans]


def test_rejects_a_waypoint_in_an_obstacle(plan_folder: Path) -> None:
    """One waypoint moved into the wall, in the table: step and obstacle are named."""
    edit_steps(plan_folder, 3, x_m="30.0", y_m="19.0")
    result = rejected(plan_folder, "step 3", "lies in obstacle wall")
    assert any("step 3: x_m is 30" in reason for reason in result.reasons)
    assert result.certificate is not None and result.certificate.min_clearance_m == 0.0


def test_rejects_a_waypoint_in_an_obstacle_in_both_files(plan_folder: Path) -> None:
    """A consistent lie about a waypoint is found by geometry alone."""
    edit_steps(plan_folder, 3, x_m="30.0", y_m="19.0")

    def move(data: dict) -> None:
        data["robots"][0]["x_m"][3], data["robots"][0]["y_m"][3] = 30.0, 19.0

    edit_json(plan_folder, "plan.json", move)
    result = rejected(plan_folder, "step 3", "lies in obstacle wall")
    assert not any("x_m is" in reason for reason in result.reasons)


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
    rejected(plan_folder, "step 2", "x_m is", "plan.json")


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
        (lambda d: d.update(verdict="violated"), ["plan.json says violated", "verified"]),
        (lambda d: d["problem_file"]["planner"].update(horizon=9), ["planner.horizon is 9"]),
        (lambda d: d["problem_file"]["planner"].update(step_s=3.0), ["planner.step_s"]),
        (lambda d: d["problem_file"]["constraints"].update(clearance_m=3.0), ["clearance_m is 3"]),
        (
            lambda d: d["problem_file"]["stations"][0].update(threshold_dbm=-30.0),
            ["constraints.p_min"],
        ),
        (lambda d: d["problem_file"]["stations"][0].update(height_m=9.0), ["the station"]),
        (lambda d: d["robots"][0]["connectivity"].__setitem__(2, 0.5), ["connectivity is not"]),
        (lambda d: d["robots"][0]["t_s"].__setitem__(2, 0.5), ["step 2: t_s"]),
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
    rejected(plan_folder, "step 2", "deviation_db is nan")


def test_rejects_measurements_that_were_changed(plan_folder: Path) -> None:
    """Powers that were raised after the plan do not give the saved sites."""
    with np.load(plan_folder / "belief.npz") as archive:
        arrays = dict(archive)
    arrays["power_dbm"] = arrays["power_dbm"] + 1.0
    np.savez(plan_folder / "belief.npz", **arrays)
    rejected(plan_folder, "belief.npz", "measurement 0")


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
    save_record(data, solution.problem, tmp_path / "plan.json")
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
        data["plans"][2]["x_m"][4], data["plans"][2]["y_m"][4] = 30.0, 19.0

    edit_json(run_folder, "run.json", move)
    result = rejected(run_folder, "the plan for step 3", "lies in obstacle wall")
    assert any("run.json says verified" in reason for reason in result.reasons)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(outcome="reached"), ["run.json says reached", "from the goal"]),
        (lambda d: d["plans"][1].update(verdict="violated"), ["step 2", "says violated"]),
        (
            lambda d: [d["plans"][1][key].pop() for key in ("x_m", "y_m")],
            ["the plan for step 2", "has 3 steps"],
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
    rejected(run_folder, "step 2", "connected does not go with true_db")


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
    rejected(run_folder, "belief.npz", "not from its place")


def test_a_run_of_no_step(tmp_path: Path) -> None:
    """Starting at the goal is a run that there is nothing to say against."""
    problem = load("open_field")
    robot = replace(problem.robots[0], start_m=problem.robots[0].goal_m)
    save_simulation(simulate(replace(problem, robots=(robot,))), tmp_path)
    result = check(tmp_path)
    assert result.verdict is Verdict.VERIFIED and result.certificate is None


def test_the_certificate_of_a_run_is_its_worst() -> None:
    """Each number is the worst over the steps; a driven step that missed the bound is listed."""
    first = Certificate(2.0, 0.9, 1e-9, None, "exact")
    second = Certificate(1.6, 0.7, 1e-7, 1e-6, "exact", (1, 2), (0.4, 0.3), (-0.2, -0.1))
    third = Certificate(1.8, 0.95, 0.0, 1e-8, "exact", (3,), (0.1,), (-0.05,))
    worst = CheckResult(Verdict.VERIFIED, (first, second, third), ()).certificate
    assert worst == Certificate(1.6, 0.7, 1e-7, 1e-6, "exact", (2,), (0.4,), (-0.2,))
