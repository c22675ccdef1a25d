"""What a saved plan says would help is judged again: limits, stages, keys and values."""

from __future__ import annotations

import copy
import json
from dataclasses import replace

import pytest
import shapely
from rules_scene import ruled_problem
from terms_scene import TRACKING, terms_problem

from planopt.planning.check.check import check
from planopt.planning.explain.explain import explain, explain_no_plan
from planopt.planning.files.saved import save_solution, write_result
from planopt.planning.files.solution_json import no_plan_json
from planopt.planning.plan import Verdict
from planopt.planning.solve import solve
from planopt.problems.load import load
from planopt.world.workspace import Obstacle


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A saved plan whose threshold is some dB too high, and what it says."""
    problem = terms_problem(TRACKING, p_min=0.8, horizon=3)
    high = replace(problem.stations[0], threshold_dbm=-23.0)
    solution = solve(replace(problem, stations=(high,)), seed=2)
    assert solution.verdict is Verdict.VIOLATED
    folder = tmp_path_factory.mktemp("violated")
    save_solution(replace(solution, explanation=explain(solution)), folder)
    return folder, json.loads((folder / "plan.json").read_text())


def blamed(folder, data) -> list[str]:
    """Reasons to reject the explanation."""
    (folder / "plan.json").write_text(json.dumps(data))
    return [reason for reason in check(folder).reasons if "explanation" in reason]


def test_it_is_found_again(saved):
    """Nothing to object but that the plan is violated."""
    folder, data = saved
    keys = {entry["constraint"] for entry in data["explanation"]}
    assert {"constraints.p_min", "stations[0].threshold_dbm"} <= keys
    assert blamed(folder, data) == []
    assert check(folder).verdict is Verdict.VIOLATED


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("constraint", "constraints.clearance_m"),
        ("robot", "nobody"),
        ("value", 0.25),
        ("stages", [1]),
        ("shortfall", 0.5),
        ("shortfall_unit", "m"),
    ],
)
def test_what_cannot_be_so(saved, key, value):
    """Every field but `verified` is judged."""
    folder, data = saved
    changed = copy.deepcopy(data)
    changed["explanation"][0][key] = value
    assert blamed(folder, changed)


HARD = {
    "average": {"p_min": 0.999},
    "outage": {"p_min": 0.9999, "outage_max_m": None, "outage_max_s": 1.0},
    "data": {"data_mbit": 9.99},
    "each_step": {"p_min": 0.99, "slack_max_db": 0.0},
}


@pytest.mark.parametrize("form", HARD)
def test_rules_are_judged_again(form, tmp_path):
    """Every key that is proposed stands; a value that is tighter, or of another rule, does not."""
    keys = {key: value for key, value in HARD[form].items() if value is not None}
    problem = ruled_problem(form, **keys) if form != "outage" else _outage(keys)
    radio = replace(problem.stations[0], threshold_dbm=-33.0)
    planner = replace(problem.planner, name="lattice", horizon=3)
    problem = replace(problem, stations=(radio,), planner=planner)
    solution = solve(problem, seed=3)
    assert solution.verdict is Verdict.VIOLATED
    save_solution(replace(solution, explanation=explain(solution)), tmp_path)
    data = json.loads((tmp_path / "plan.json").read_text())
    assert len(data["explanation"]) > 2 and blamed(tmp_path, data) == []
    for number, entry in enumerate(data["explanation"]):
        for key, value in (
            ("relaxed_value", 2.0 * entry["value"] - entry["relaxed_value"]),
            ("stages", [*entry["stages"], 99]),
            ("shortfall", entry["shortfall"] + 0.1),
            ("constraint", "constraints.deadline_h"),
        ):
            changed = copy.deepcopy(data)
            changed["explanation"][number][key] = value
            assert blamed(tmp_path, changed), (entry, key)


def _outage(keys):
    """The rule on outages, in seconds."""
    problem = ruled_problem("outage", p_min=keys["p_min"])
    rule = replace(problem.constraints.rule, outage_max_m=None, outage_max_s=keys["outage_max_s"])
    return replace(problem, constraints=replace(problem.constraints, rule=rule))


def test_a_verified_plan_needs_no_explanation(tmp_path, saved):
    """One that has one is rejected."""
    save_solution(solve(terms_problem(TRACKING, horizon=2), seed=2), tmp_path)
    data = json.loads((tmp_path / "plan.json").read_text())
    assert data["explanation"] == [] and check(tmp_path).reasons == ()
    assert blamed(tmp_path, {**data, "explanation": saved[1]["explanation"][:1]})


def test_a_robot_that_there_is_not(tmp_path):
    """To a goal as well: an explanation is of a robot of the problem."""
    problem = load("open_field")
    radio = problem.stations[0]
    deaf = replace(problem, stations=(replace(radio, threshold_dbm=radio.threshold_dbm + 80.0),))
    solution = solve(deaf, horizon=2)
    assert solution.plan.verdict is Verdict.VIOLATED
    solution = replace(solution, explanation=explain(solution))
    save_solution(solution, tmp_path)
    data = json.loads((tmp_path / "plan.json").read_text())
    assert blamed(tmp_path, data) == []
    data["explanation"][0]["robot"] = "nobody"
    assert any("nobody" in reason for reason in blamed(tmp_path, data))


def test_no_plan(tmp_path):
    """A way that obstacles close: the clearance that opens it, or not."""
    problem = load("open_field")
    (x, y), (x_goal, y_goal) = problem.robots[0].start_m, problem.robots[0].goal_m
    ring = shapely.Point(x_goal, y_goal).buffer(12.0) - shapely.Point(x_goal, y_goal).buffer(8.0)
    # A gate of 1.5 m.
    gate = shapely.LineString([(x_goal, y_goal), (x, y)]).buffer(0.75)
    wall = Obstacle("wall", ring.difference(gate))
    workspace = replace(problem.workspace, obstacles=(*problem.workspace.obstacles, wall))
    problem = replace(problem, workspace=workspace)
    assert problem.constraints.clearance_m > 0.75
    explanation = explain_no_plan(problem, 0)
    keys = [relaxation.constraint for relaxation in explanation]
    assert keys == ["constraints.clearance_m", "world.obstacles (wall)"]
    file = tmp_path / "plan.json"
    data = no_plan_json(problem, 0, "obstacles cut it off", explanation)
    write_result(data, problem, file)
    saved = json.loads(file.read_text())
    assert blamed(tmp_path, saved) == []
    saved["explanation"][0]["relaxed_value"] = 0.8
    assert blamed(tmp_path, saved)
    saved["explanation"][0]["constraint"] = "world.obstacles (none)"
    assert blamed(tmp_path, saved)
