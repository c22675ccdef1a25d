"""Saved plans and runs of several robots: check agrees with them, and rejects what is edited."""

import csv
import json
import shutil
from pathlib import Path

import pytest
from team_scene import two_trackers
from terms_scene import CONNECT, ENERGY, LEARNING, TRACKING, own_term, terms_problem

from planopt.errors import InputError
from planopt.planning.check.check import check
from planopt.planning.files.saved import save_run, save_solution
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.plan import Verdict
from planopt.planning.solve import solve

STEERED = {
    "kind": "mapping",
    "form": "two_layer",
    "variance_threshold_db2": 4.0,
    "closeness_per_m": 0.02,
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Plans and a run of two robots."""
    folder = tmp_path_factory.mktemp("made")
    for name in ("plan", "run"):
        (folder / name).mkdir()
    save_solution(solve(two_trackers(), seed=1), folder / "plan")
    save_run(simulate(two_trackers(), seed=1), folder / "run")
    return folder


@pytest.fixture
def plan(made: Path, tmp_path: Path) -> Path:
    """A copy of the plans."""
    return Path(shutil.copytree(made / "plan", tmp_path / "plan"))


@pytest.fixture
def run(made: Path, tmp_path: Path) -> Path:
    """A copy of the run."""
    return Path(shutil.copytree(made / "run", tmp_path / "run"))


def change(file: Path, *way: str | int, to: object) -> None:
    """Set the value at `way` of a JSON file; a function is given the old value."""
    data = json.loads(file.read_text())
    place = data
    for key in way[:-1]:
        place = place[key]
    place[way[-1]] = to(place[way[-1]]) if callable(to) else to
    file.write_text(json.dumps(data))


def change_cell(file: Path, row: int, column: str, to: str) -> None:
    """Set a cell of a table, row 0 below the header."""
    rows = list(csv.reader(file.read_text().splitlines()))
    rows[row + 1][rows[0].index(column)] = to
    file.write_text("\n".join(map(",".join, rows)) + "\n")


def test_what_was_saved_is_verified(plan: Path, run: Path) -> None:
    """The files of the contract, and nothing to object to."""
    assert {f.name for f in plan.iterdir()} == {"plan.json", "steps.csv", "belief.npz"}
    assert {f.name for f in run.iterdir()} == {
        "run.json",
        "steps.csv",
        "target.csv",
        "knowledge.csv",
        "belief_robot.npz",
        "belief_second.npz",
    }
    assert check(plan).reasons == () and check(plan).verdict is Verdict.VERIFIED
    found = check(run)
    assert found.reasons == () and len(found.certificates) == 3


@pytest.mark.parametrize("terms", [(STEERED,), (LEARNING, ENERGY)])
@pytest.mark.parametrize("planner", ["auto", "lattice", "random"])
def test_every_task_is_judged(terms: tuple[dict, ...], planner: str, tmp_path: Path) -> None:
    """What steers is said to be taken as it stands, and only there."""
    problem = terms_problem(*terms, name=planner, horizon=2, max_steps=3, p_min=0.5)
    save_run(simulate(problem, seed=2), tmp_path)
    result = check(tmp_path)
    assert result.verdict is Verdict.VERIFIED, result.reasons
    assert any("steering_m" in remark for remark in result.remarks) == (terms == (STEERED,))
    assert not (tmp_path / "target.csv").exists() and (tmp_path / "belief.npz").is_file()


def test_what_the_station_knew_is_found_again(tmp_path: Path) -> None:
    """The worth of a plan that follows the station's filter, at every step."""
    problem = terms_problem({**TRACKING, "form": "recourse"}, horizon=2, max_steps=3)
    save_run(simulate(problem, seed=2), tmp_path)
    assert check(tmp_path).reasons == ()


OWN = own_term(lambda path: path.connectivity[0] + path.mean_db[1] / path.deviation_db[1], 2)


@pytest.mark.parametrize("terms", [(CONNECT,), (CONNECT, ENERGY), (OWN,)])
@pytest.mark.parametrize("planner", ["auto", "one_step"])
def test_plans_that_find_connection_are_judged(
    terms: tuple[dict, ...], planner: str, tmp_path: Path
) -> None:
    """The problem in the file, the worth of every plan, everything."""
    problem = terms_problem(*terms, horizon=2, max_steps=3, name=planner)
    save_run(simulate(problem, seed=2), tmp_path)
    assert check(tmp_path).reasons == ()
    change(tmp_path / "run.json", "plans", 0, "released", 0, "objective", to=lambda old: old + 1.0)
    assert any("objective" in reason for reason in check(tmp_path).reasons)


@pytest.mark.parametrize(
    ("way", "to", "words"),
    [
        (("objective",), lambda old: old + 1.0, "key objective"),
        (("robots", 1, "objective"), lambda old: old + 1.0, r"key robots\[1\].objective"),
        (("robots", 1, "verdict"), "violated", r"key robots\[1\].verdict"),
        (("robots", 0, "rung"), "stop", r"rung: stop, but the path does not stand still"),
        (("robots", 0, "rung"), "ladder", "should be one of"),
        (("robots", 0, "aim", "target_x_m", 1), lambda old: old + 1.0, "aim.target_x_m"),
        (("robots", 0, "solve_s"), 1e6, "but wall_s is"),
        (("certificate", "min_clearance_m"), 9.0, "certificate.min_clearance_m"),
        (("seed",), 2, "with seed 2"),
        (("extra",), 1, "no such key"),
    ],
)
def test_an_edited_plan_is_rejected(plan: Path, way: tuple, to: object, words: str) -> None:
    """The reason names the key."""
    data = json.loads((plan / "plan.json").read_text())
    data.setdefault("extra", None) if way == ("extra",) else None
    (plan / "plan.json").write_text(json.dumps(data))
    change(plan / "plan.json", *way, to=to)
    _rejected(plan, words)


@pytest.mark.parametrize(
    ("way", "to", "words"),
    [
        (("metrics", "time_averaged_trace_p"), 0.01, "metrics.time_averaged_trace_p"),
        (("metrics", "delivered"), 0.5, "metrics.delivered"),
        (("metrics", "rms_db"), 0.5, "metrics.rms_db"),
        (("verified_rate",), 0.5, "verified_rate"),
        (("rungs", "plan"), 5, "rungs.plan"),
        (("outcome",), "reached", "key outcome"),
        (("plans", 1, "released", 2, "x_m", 1), lambda old: old + 0.3, "not the first step"),
        (("plans", 1, "released", 2, "objective"), 1e3, r"released\[2\].objective"),
        (("plans", 0, "released", 1, "verdict"), "violated", r"released\[1\].verdict"),
        (("plans", 0, "released", 1, "termination"), "no_path", "termination"),
        (("plans", 0, "robot"), "third", r"plans\[0\].robot"),
        (("step_s", "p50"), 1e6, "out of order"),
    ],
)
def test_an_edited_run_is_rejected(run: Path, way: tuple, to: object, words: str) -> None:
    """The reason names the key."""
    change(run / "run.json", *way, to=to)
    _rejected(run, words)


@pytest.mark.parametrize(
    ("file", "row", "column", "to", "words"),
    [
        ("steps.csv", 1, "x_m", "20.0", "lies in obstacle"),
        ("steps.csv", 5, "true_db", "-1.0", "row 7, step 1: true_db"),
        ("steps.csv", 0, "robot", "third", "robot is"),
        ("steps.csv", 4, "y_m", "11.0", "second does not start at"),
        ("target.csv", 2, "estimated_x_m", "3.0", r"target.csv, key estimated_x_m\[2\]"),
        ("target.csv", 1, "delivered_second", "0.0", r"delivered_second\[1\]"),
        ("knowledge.csv", 3, "rms_db", "0.1", r"knowledge.csv, key rms_db\[3\]"),
    ],
)
def test_an_edited_table_is_rejected(
    run: Path, file: str, row: int, column: str, to: str, words: str
) -> None:
    """The reason names file, row and column."""
    if (file, row) == ("target.csv", 1):
        to = "0.0" if (run / file).read_text().splitlines()[2].endswith("1.0") else "1.0"
    change_cell(run / file, row, column, to)
    _rejected(run, words)


@pytest.mark.parametrize(
    ("file", "way", "to", "words"),
    [
        ("plan/plan.json", ("robots",), lambda old: old[:1], "1 robots, the problem has 2"),
        ("run/run.json", ("plans",), lambda old: old[:1], "of 1 robots where there are 2"),
        ("run/run.json", ("plans", 0, "released"), lambda old: old[:1], "1 plans for 3 steps"),
        ("run/run.json", ("robots", 0, "x_m"), lambda old: old[:1], "differ in length"),
        ("run/run.json", ("plans", 0, "released", 0, "y_m"), [1.0], "x_m and y_m differ"),
    ],
)
def test_damaged_files_are_errors(
    plan: Path, run: Path, file: str, way: tuple, to: object, words: str
) -> None:
    """What cannot be read is an error, not a verdict."""
    folder = plan.parent
    change(folder / file, *way, to=to)
    with pytest.raises(InputError, match=words):
        check(folder / file)


def test_tables_have_a_row_for_every_step(run: Path) -> None:
    """A row too few is an error."""
    lines = (run / "knowledge.csv").read_text().splitlines()
    (run / "knowledge.csv").write_text("\n".join(lines[:-1]))
    with pytest.raises(InputError, match=r"has 3 rows where run\.json has 4 places"):
        check(run)


def test_another_length_than_asked_is_rejected(plan: Path, run: Path) -> None:
    """Horizon and number of steps are those of the problem."""
    change(plan / "plan.json", "problem_file", "planner", "horizon", to=3)
    _rejected(plan, "2 steps of robot are planned, planner.horizon is 3")
    change(run / "run.json", "problem_file", "planner", "max_steps", to=9)
    _rejected(run, "the run ends after step 3, planner.max_steps is 9")
    change(run / "run.json", "problem_file", "planner", "horizon", to=3)
    _rejected(run, "has 2 steps, planner.horizon is 3")


def test_without_the_truth_what_was_known_is_taken_as_it_stands(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rest is still judged: deliveries from the true powers that the table has."""

    def missing(*_: object) -> None:
        raise InputError("the file is gone")

    monkeypatch.setattr("planopt.planning.check.check_belief.draw", missing)
    result = check(run)
    assert result.verdict is Verdict.VERIFIED, result.reasons
    assert any("knowledge.csv is taken" in remark for remark in result.remarks)
    change(run / "run.json", "metrics", "delivered", to=0.5)
    _rejected(run, "metrics.delivered")


def _rejected(folder: Path, words: str) -> None:
    result = check(folder)
    assert result.verdict is Verdict.VIOLATED
    assert any(_has(words, reason) for reason in result.reasons), result.reasons


def _has(words: str, reason: str) -> bool:
    return words.replace("\\", "") in reason
