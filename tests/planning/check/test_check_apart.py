"""Saved plans and runs of robots that keep apart: check agrees, and rejects what is edited."""

import json
import shutil
from pathlib import Path

import pytest
from apart_scene import apart_problem

from planopt.planning.check.check import check
from planopt.planning.files.saved import save_run, save_solution
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.plan import Verdict
from planopt.planning.solve import solve


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Plans and a run of three robots beside a cart."""
    folder = tmp_path_factory.mktemp("made")
    problem = apart_problem([(10, 15), (14, 15), (10, 22)], max_steps=4, horizon=3)
    for name in ("plan", "run"):
        (folder / name).mkdir()
    save_solution(solve(problem, seed=1), folder / "plan")
    save_run(simulate(problem, seed=1), folder / "run")
    return folder


def edited(made: Path, to: Path, name: str, *way: str | int, value: object) -> tuple[str, ...]:
    """The reasons of `name` with the value at `way` of its JSON file set to another."""
    folder = Path(shutil.copytree(made / name, to / name))
    file = folder / f"{name}.json"
    data = json.loads(file.read_text())
    place = data
    for key in way[:-1]:
        place = place[key]
    place[way[-1]] = value(place[way[-1]]) if callable(value) else value
    file.write_text(json.dumps(data))
    result = check(folder)
    assert result.verdict is Verdict.VIOLATED
    return result.reasons


@pytest.mark.parametrize("name", ["plan", "run"])
def test_what_was_saved_is_verified(made: Path, name: str) -> None:
    """And the certificate says how far everything keeps away."""
    result = check(made / name)
    assert result.verdict is Verdict.VERIFIED, result.reasons
    assert result.certificate is not None
    assert result.certificate.min_separation_m >= 3.0 - 1e-6
    assert result.certificate.min_moving_clearance_m >= 0.5 - 1e-6


@pytest.mark.parametrize(
    ("name", "way", "value", "words"),
    [
        ("plan", ("certificate", "min_separation_m"), 9.0, "certificate.min_separation_m"),
        ("plan", ("certificate", "min_moving_clearance_m"), 9.0, "min_moving_clearance_m"),
        (
            "plan",
            ("robots", 1, "certificate", "min_separation_m"),
            None,
            r"robots[1].certificate.min_separation_m",
        ),
        ("run", ("metrics", "min_separation_m"), 9.0, "metrics.min_separation_m"),
        ("run", ("metrics", "min_moving_clearance_m"), 9.0, "metrics.min_moving_clearance_m"),
        ("run", ("plans", 1, "released", 2, "rung"), "reserved", "rung: reserved, but the path"),
        (
            "run",
            ("problem_file", "constraints", "separation_m"),
            3.9,
            "of the robot r1, constraints.separation_m is 3.9",
        ),
        (
            "run",
            ("problem_file", "world", "moving", 0, "positions_m", 0),
            [8.0, 18.0],
            "of the moving obstacle cart, constraints.clearance_m is 0.5",
        ),
    ],
)
def test_what_was_edited_is_rejected(
    made: Path, tmp_path: Path, name: str, way: tuple, value: object, words: str
) -> None:
    """With the key, or with what comes too near to what."""
    reasons = edited(made, tmp_path, name, *way, value=value)
    assert any(words in reason for reason in reasons), reasons


def test_a_robot_planned_into_another_is_rejected(made: Path, tmp_path: Path) -> None:
    """Both certificates say so, each of the other robot."""
    data = json.loads((made / "run" / "run.json").read_text())
    place = data["plans"][0]["released"][3]
    released = ("run", "plans", 1, "released", 3)
    way = {axis: place[axis][3] for axis in ("x_m", "y_m")}
    edited(made, tmp_path, *released, "x_m", 3, value=way["x_m"])
    folder = Path(shutil.copytree(tmp_path / "run", tmp_path / "both" / "run")).parent
    reasons = edited(folder, tmp_path / "again", *released, "y_m", 3, value=way["y_m"])
    for number, other in ((0, "r1"), (1, "r0")):
        where = f"plans[{number}].released[3]"
        assert any(where in reason and f"of the robot {other}" in reason for reason in reasons)
