"""Saved results of teams and of every kind of term: check agrees, and rejects what is edited."""

import json
import shutil
from pathlib import Path

import pytest
from apart_scene import apart_problem
from team_scene import two_trackers
from terms_scene import CONNECT, ENERGY, LEARNING, TRACKING, own_term, terms_problem

from planopt import InputError, Verdict, check, simulate, solve

STEERED = {
    "kind": "mapping",
    "form": "two_layer",
    "variance_threshold_db2": 4.0,
    "closeness_per_m": 0.02,
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Plans and runs of two trackers, and of three robots that keep apart beside a cart."""
    folder = tmp_path_factory.mktemp("made")
    apart = apart_problem([(10, 15), (14, 15), (10, 22)], max_steps=4, horizon=3)
    solve(two_trackers(), seed=1).save(folder / "plan")
    simulate(two_trackers(), seed=1).save(folder / "run")
    solve(apart, seed=1).save(folder / "apart_plan")
    simulate(apart, seed=1).save(folder / "apart_run")
    return folder


def change(file: Path, *way: str | int, to: object) -> None:
    """Set the value at `way` of a JSON file; a function is given the old value."""
    data = json.loads(file.read_text())
    place = data
    for key in way[:-1]:
        place = place[key]
    place[way[-1]] = to(place[way[-1]]) if callable(to) else to
    file.write_text(json.dumps(data))


def reasons(folder: Path) -> tuple[str, ...]:
    result = check(folder)
    assert result.verdict is Verdict.VIOLATED
    return result.reasons


@pytest.mark.parametrize("name", ["plan", "run", "apart_plan", "apart_run"])
def test_what_was_saved_is_verified(made: Path, name: str) -> None:
    """The files of the contract, and nothing to object to; robots keep apart."""
    result = check(made / name)
    assert result.verdict is Verdict.VERIFIED, result.reasons
    files = {"steps.csv", "run.json" if name.endswith("run") else "plan.json"}
    files |= {"belief.npz"} if name.endswith("plan") else set()
    if name == "run":
        files |= {"target.csv", "knowledge.csv", "belief_robot.npz", "belief_second.npz"}
        assert len(result.certificates) == 3
    assert {f.name for f in (made / name).iterdir()} >= files
    if name.startswith("apart"):
        assert result.certificate is not None
        assert result.certificate.min_separation_m >= 3.0 - 1e-6
        assert result.certificate.min_moving_clearance_m >= 0.5 - 1e-6


OWN = own_term(lambda path: path.connectivity[0] + path.mean_db[1] / path.deviation_db[1], 2)


@pytest.mark.parametrize(
    ("terms", "planner"),
    [
        ((STEERED,), "auto"),
        ((STEERED,), "lattice"),
        ((LEARNING, ENERGY), "auto"),
        ((LEARNING, ENERGY), "random"),
        ((TRACKING,), "auto"),
        ((CONNECT,), "auto"),
        ((CONNECT,), "one_step"),
        ((OWN,), "auto"),
    ],
)
def test_every_task_is_judged(terms: tuple[dict, ...], planner: str, tmp_path: Path) -> None:
    """The problem in the file, the worth of every plan, everything."""
    problem = terms_problem(*terms, name=planner, horizon=2, max_steps=3, p_min=0.5)
    simulate(problem, seed=2).save(tmp_path)
    assert check(tmp_path).reasons == ()
    change(tmp_path / "run.json", "plans", 0, "released", 0, "objective", to=lambda old: old + 1.0)
    assert any("objective" in reason for reason in reasons(tmp_path))


@pytest.mark.parametrize(
    ("name", "way", "to", "words"),
    [
        ("plan", ("objective",), lambda old: old + 1.0, "key objective"),
        ("plan", ("robots", 1, "verdict"), "violated", "key robots[1].verdict"),
        ("plan", ("robots", 0, "aim", "target_x_m", 1), lambda old: old + 1.0, "aim.target_x_m"),
        ("plan", ("certificate", "min_clearance_m"), 9.0, "certificate.min_clearance_m"),
        ("run", ("metrics", "time_averaged_trace_p"), 0.01, "metrics.time_averaged_trace_p"),
        ("run", ("metrics", "delivered"), 0.5, "metrics.delivered"),
        ("run", ("verified_rate",), 0.5, "verified_rate"),
        ("run", ("rungs", "plan"), 5, "rungs.plan"),
        ("run", ("outcome",), "reached", "key outcome"),
        ("run", ("plans", 1, "released", 2, "x_m", 1), lambda old: old + 0.3, "steps.csv, row"),
        ("run", ("plans", 0, "robot"), "third", "plans[0].robot"),
        ("run", ("problem_file", "planner", "max_steps"), 9, "the run ends after step 3"),
        ("apart_plan", ("certificate", "min_separation_m"), 9.0, "certificate.min_separation_m"),
        ("apart_run", ("metrics", "min_moving_clearance_m"), 9.0, "metrics.min_moving_clearance"),
        (
            "apart_run",
            ("problem_file", "constraints", "separation_m"),
            3.9,
            "of the robot r1, constraints.separation_m is 3.9",
        ),
        (
            "apart_run",
            ("problem_file", "world", "moving", 0, "positions_m", 0),
            [8.0, 18.0],
            "of the moving obstacle cart, constraints.clearance_m is 0.5",
        ),
    ],
)
def test_what_was_edited_is_rejected(
    made: Path, tmp_path: Path, name: str, way: tuple, to: object, words: str
) -> None:
    """The reason names the key, or what comes too near to what."""
    folder = Path(shutil.copytree(made / name, tmp_path / name))
    change(next(folder.glob("*.json")), *way, to=to)
    found = reasons(folder)
    assert any(words in reason for reason in found), found


@pytest.mark.parametrize(
    ("file", "way", "to", "words"),
    [
        ("plan/plan.json", ("robots",), lambda old: old[:1], "1 robots, the problem has 2"),
        ("plan/plan.json", ("problem_file", "planner", "horizon"), 3, "planner.horizon is 3"),
        ("run/run.json", ("plans",), lambda old: old[:1], "1 robots, the problem has 2"),
        ("run/run.json", ("plans", 0, "released"), lambda old: old[:1], "[1, 3] plans"),
        ("run/run.json", ("plans", 0, "released", 0, "y_m"), [1.0], "x_m and y_m differ"),
    ],
)
def test_damaged_files_are_errors(
    made: Path, tmp_path: Path, file: str, way: tuple, to: object, words: str
) -> None:
    """What cannot be read is an error, not a verdict."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    change(tmp_path / file, *way, to=to)
    with pytest.raises(InputError) as raised:
        check(tmp_path / file)
    assert words in str(raised.value)
