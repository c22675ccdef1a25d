"""Errors, pictures and files if a hard connectivity bound forbids every route to a goal."""

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from artists import drawn
from refusals import refused

from planopt import ConnectivityRule, Obstacle, Problem, check, load, load_result, simulate, solve
from planopt.cli import main
from planopt.extend import BlockedError
from planopt.planning.initial_data import prepare
from planopt.problems.library import library_folder
from planopt.report import draw_no_plan, draw_run, save_figure

CHANGES = {
    "p_min = 0.8": "p_min = 0.8\nslack_max_db = 0.0",
    "threshold_dbm = -59": "threshold_dbm = -45",
}


@pytest.fixture(scope="module")
def problem() -> Problem:
    """The open field, whose goal is out of contact with a receiver that is worse."""
    field = load("open_field")
    rule = ConnectivityRule(slack_max_db=0.0)
    (station,) = field.stations
    return replace(
        field,
        stations=(replace(station, threshold_dbm=-45.0),),
        constraints=replace(field.constraints, rule=rule),
    )


@pytest.fixture(scope="module")
def error(problem: Problem) -> BlockedError:
    with pytest.raises(BlockedError) as caught:
        solve(problem, seed=1)
    return caught.value


def test_error_has_the_route_and_its_holes(problem, error) -> None:
    """From the start to the goal; holes are on the route, and below the bound."""
    (one,) = error.blocked
    assert one.robot == problem.robots[0].name and one.holes
    np.testing.assert_allclose(one.path_m[0], problem.robots[0].start_m)
    radius = problem.constraints.goal_radius_m
    assert np.linalg.norm(one.path_m[-1] - problem.goal_m) <= radius + 1e-9
    for hole in one.holes:
        assert min(np.linalg.norm(one.path_m - np.array(hole.from_m), axis=1)) == 0.0
        assert hole.least_connectivity < problem.constraints.p_min


def test_the_pictures_show_the_holes(problem, error, tmp_path: Path) -> None:
    """Of a plan and of a run; the words fit, so that the map keeps its size."""
    run = simulate(problem, seed=1)
    assert run.outcome.value == "no_plan" and str(error) == run.reason
    belief = prepare(problem, 1).belief
    figures = (draw_no_plan(problem, belief, str(error), error.blocked), draw_run(run))
    for number, figure in enumerate(figures):
        axes = drawn(figure).axes[0]
        labels = [artist.get_label() for artist in axes.get_lines()]
        assert labels.count("coverage hole on the path") == len(error.blocked[0].holes)
        assert max(map(len, axes.get_title("left").splitlines())) <= 110
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            save_figure(figure, tmp_path / f"{number}.png")
        assert axes.get_position().width > 0.6


def test_files_name_the_holes(error, tmp_path: Path, capsys) -> None:
    """`solve` draws them too; `check` takes the folder for one without a plan."""
    text = (library_folder() / "open_field.toml").read_text()
    for was, now in CHANGES.items():
        assert was in text
        text = text.replace(was, now)
    file = tmp_path / "p.toml"
    file.write_text(text)
    assert main(["solve", str(file), "--seed", "1", "--out", str(tmp_path / "plan")]) == 4
    assert (tmp_path / "plan" / "plan.png").stat().st_size > 1000
    assert main(["simulate", str(file), "--seed", "1", "--out", str(tmp_path / "run")]) == 4
    for name in ("plan", "run"):
        data = json.loads((tmp_path / name / f"{name}.json").read_text())
        ((way,), one) = data["blocked"], error.blocked[0]
        assert way["robot"] == one.robot and way["x_m"] == one.path_m[:, 0].tolist()
        assert [hole["length_m"] for hole in way["holes"]] == [h.length_m for h in one.holes]
    capsys.readouterr()
    main(["check", str(tmp_path / "plan")])
    assert "blocked" not in capsys.readouterr().out


def test_a_saved_run_keeps_its_refusal(problem, tmp_path: Path, capsys) -> None:
    """Read again it ended as it did, for the same reason; `check` does not call this violated."""
    run = simulate(problem, seed=1)
    run.save(tmp_path)
    assert main(["check", str(tmp_path)]) == 0, capsys.readouterr().out
    again = load_result(tmp_path)
    assert (again.outcome, again.reason) == (run.outcome, run.reason)
    (way,), (other,) = run.blocked, again.blocked
    assert (way.robot, way.holes) == (other.robot, other.holes)
    np.testing.assert_array_equal(way.path_m, other.path_m)


def test_refusal_during_a_run_is_not_violated(problem, tmp_path: Path, capsys) -> None:
    """A known gate closes the connected route; a route from elsewhere refuses nothing."""
    gate = Obstacle("gate", shapely.box(58.0, 0.0, 62.0, 16.5), known_from_s=4.0)
    closed = replace(
        problem,
        workspace=replace(problem.workspace, timed=(gate,)),
        stations=(replace(problem.stations[0], threshold_dbm=-52.0),),
        constraints=replace(problem.constraints, p_min=0.5),
        planner=replace(problem.planner, horizon=3, max_steps=6),
    )
    run = simulate(closed, seed=1)
    assert run.outcome.value == "no_plan" and len(run.plans[0]) == 2 and run.blocked
    run.save(tmp_path)
    assessed = check(tmp_path)
    assert (assessed.verdict, assessed.reasons) == ("verified", ())
    file = tmp_path / "run.json"
    data = json.loads(file.read_text())
    data["blocked"][0]["y_m"][0] += 0.1
    file.write_text(json.dumps(data))
    assert any("neither its task nor a standstill" in reason for reason in check(tmp_path).reasons)


@pytest.mark.parametrize("damage", ["robot", "x_m", "missing"])
def test_a_damaged_refusal_is_an_error(problem, tmp_path: Path, capsys, damage: str) -> None:
    """Ways are of robots that there are, with as many x as y; without one the run is violated."""
    simulate(problem, seed=1).save(tmp_path)
    file = tmp_path / "run.json"
    data = json.loads(file.read_text())
    if damage == "missing":
        del data["blocked"]
        file.write_text(json.dumps(data))
        assert main(["check", str(tmp_path)]) != 0
        assert "neither its task nor a standstill" in capsys.readouterr().out
        return
    data["blocked"][0][damage] = "nobody" if damage == "robot" else [1.0]
    file.write_text(json.dumps(data))
    with refused():
        load_result(tmp_path)
