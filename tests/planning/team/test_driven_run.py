"""Closed loops of robots that cannot turn or stop at will; saved, and judged again from disk."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import numpy as np
import pytest
from motion_scene import DOUBLE, WHEELS, with_dynamics
from terms_scene import LEARNING, TABLES, TRACKING, terms_problem

from planopt import check
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.plan import Rung, Verdict
from planopt.planning.solve import solve
from planopt.problems.problem import Problem, problem_from_tables


def random_scene(seed: int) -> Problem:
    """Some boxes, a robot of random dynamics at a random place, with or without a bound."""
    generator = np.random.default_rng(seed)
    tables = copy.deepcopy(TABLES)
    start = generator.uniform(3.0, 37.0, 2)
    boxes = []
    while len(boxes) < 5:
        (x, y), (w, h) = generator.uniform(5.0, 35.0, 2), generator.uniform(0.5, 5.0, 2)
        if max(abs(start[0] - x) - w, abs(start[1] - y) - h) > 1.0:
            boxes.append(
                {"polygon": [[x - w, y - h], [x + w, y - h], [x + w, y + h], [x - w, y + h]]}
            )
    tables["world"]["obstacles"] = boxes
    track = bool(generator.random() < 0.5)
    tables["objective"] = {"terms": [TRACKING if track else LEARNING]}
    tables["problem"]["task"] = "track" if track else "learn"
    if track:
        tables["targets"] = [
            {"start_m": [14.0, 18.0], "velocity_m_s": list(generator.normal(size=2))}
        ]
    tables["constraints"]["p_min"] = float(generator.choice([0.0, 0.6]))
    robot = {"start_m": start.tolist(), "speed_max_m_s": 2.0}
    if seed % 2:
        velocity = generator.uniform(-0.3, 0.3, 2).tolist()
        largest = float(generator.choice([0.3, 1.0]))
        robot |= {"dynamics": "double_integrator", "acceleration_max_m_s2": largest}
        robot["start_velocity_m_s"] = velocity
    else:
        rate = float(generator.choice([0.3, 1.0, 3.0]))
        robot |= {"dynamics": "unicycle", "turn_rate_max_rad_s": rate}
        robot["start_heading_rad"] = float(generator.uniform(0.0, 6.0))
    tables["robots"] = [robot]
    tables["planner"] |= {"horizon": int(generator.choice([1, 3, 5])), "max_steps": 6}
    return problem_from_tables(tables, folder=Path(), file=None)


@pytest.mark.parametrize("seed", range(8))
def test_every_released_plan_is_sound(seed: int) -> None:
    """Clear, driven, on a declared rung; what is not verified lacks connectivity alone."""
    problem = random_scene(seed)
    run = simulate(problem, seed=seed)
    state = problem.robots[0].start_state
    for plan in run.plans[0]:
        assert plan.drive.states[0] == pytest.approx(state, abs=1e-9)
        state = plan.drive.states[1]
        assert plan.rung in Rung
        assert plan.certificate.dynamics_defect <= 1e-5
        assert plan.certificate.min_clearance_m >= problem.constraints.clearance_m - 1e-6
        if plan.verdict is not Verdict.VERIFIED:
            assert all("p_min" in reason for reason in plan.certificate.reasons)


def pair() -> Problem:
    """A double integrator and a unicycle that track."""
    tables = copy.deepcopy(TABLES)
    tables["objective"] = {"terms": [TRACKING]}
    tables["problem"]["task"] = "track"
    tables["targets"] = [{"start_m": [14.0, 18.0], "velocity_m_s": [0.9, 0.2]}]
    tables["robots"] = [
        {"name": "heavy", "start_m": [10.0, 15.0], "speed_max_m_s": 2.0}
        | {"dynamics": "double_integrator", "acceleration_max_m_s2": 0.8},
        {"name": "wheels", "start_m": [30.0, 10.0], "speed_max_m_s": 2.0}
        | {"dynamics": "unicycle", "turn_rate_max_rad_s": 1.0},
        {"name": "free", "start_m": [8.0, 30.0], "speed_max_m_s": 2.0},
    ]
    tables["planner"] |= {"horizon": 3, "max_steps": 3}
    return problem_from_tables(tables, folder=Path(), file=None)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Plans and a run of the pair, saved."""
    folders = {name: tmp_path_factory.mktemp(name) for name in ("plan", "run")}
    solve(pair(), seed=2).save(folders["plan"])
    simulate(pair(), seed=2).save(folders["run"])
    return folders


@pytest.mark.parametrize("name", ["plan", "run"])
def test_saved_results_are_judged_again(saved, name: str) -> None:
    """As they are, they are verified."""
    result = check(saved[name])
    assert result.reasons == ()
    assert result.verdict is Verdict.VERIFIED


MOTION = (
    "velocity_x_m_s,velocity_y_m_s,acceleration_x_m_s2,acceleration_y_m_s2,heading_rad,"
    "speed_m_s,turn_rate_rad_s"
)


@pytest.mark.parametrize("name", ["plan", "run"])
@pytest.mark.parametrize("column", MOTION.split(","))
def test_an_edited_cell_is_rejected(saved, tmp_path: Path, name: str, column: str) -> None:
    """A thousandth more in any column of states and inputs."""
    for file in saved[name].iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    table = tmp_path / "steps.csv"
    header, *rows = (line.split(",") for line in table.read_text().splitlines())
    at = header.index(column)
    row = next(row for row in rows if row[1] == "2" and row[at])
    row[at] = repr(float(row[at]) + 1e-3)
    table.write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")
    result = check(tmp_path)
    assert result.verdict is Verdict.VIOLATED
    assert result.reasons


@pytest.mark.parametrize("key", ["velocity_y_m_s", "acceleration_x_m_s2"])
def test_an_edited_plan_of_a_run_is_rejected(saved, tmp_path: Path, key: str) -> None:
    """States and inputs of released plans, too."""
    for file in saved["run"].iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    data = json.loads((tmp_path / "run.json").read_text())
    data["plans"][0]["released"][1]["drive"][key][2] += 1e-3
    (tmp_path / "run.json").write_text(json.dumps(data))
    result = check(tmp_path)
    assert result.verdict is Verdict.VIOLATED
    assert any("do not lead from state to state" in reason for reason in result.reasons)


def test_files_of_single_integrators_are_as_they_were(tmp_path: Path) -> None:
    """No column and no key more."""
    solve(terms_problem(TRACKING, horizon=2)).save(tmp_path)
    assert (tmp_path / "steps.csv").read_text().splitlines()[0].endswith(",rung,verdict")
    assert "drive" not in (tmp_path / "plan.json").read_text()


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_same_seed_same_run(dynamics) -> None:
    """Bit for bit."""
    problem = with_dynamics(terms_problem(TRACKING, horizon=3, max_steps=3), dynamics)
    first, second = (simulate(problem, seed=1) for _ in range(2))
    assert np.array_equal(first.runs[0].log.positions_m, second.runs[0].log.positions_m)
    assert np.array_equal(first.runs[0].drive.inputs, second.runs[0].drive.inputs)
