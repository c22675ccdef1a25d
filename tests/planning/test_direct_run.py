"""The bound on a run's length (equation 6.8), and direct drives from rest to rest."""

from pathlib import Path

import numpy as np
import pytest
from strip_scene import STATION, strip

from planopt import Problem, Run, check
from planopt.extend import Rung
from planopt.planning.scene import Scene, build_scene, first_moves
from planopt.planning.search.global_search import GlobalSearch
from planopt.planning.solve import simulate
from planopt.problems import DoubleIntegrator, Unicycle
from planopt.robots.dynamics import rolled_out

ROBOTS = {
    "single": {"speed_max_m_s": 3.0},
    "double_integrator": {
        "speed_max_m_s": 3.0,
        "dynamics": "double_integrator",
        "acceleration_max_m_s2": 1.5,
    },
    "unicycle": {"speed_max_m_s": 3.0, "dynamics": "unicycle", "turn_rate_max_rad_s": 0.8},
}
DYNAMICS = (DoubleIntegrator(3.0, 1.5), Unicycle(3.0, 0.8))


@pytest.mark.parametrize("dynamics", DYNAMICS, ids=lambda dynamics: dynamics.kind)
def test_straight_inputs_lead_from_rest_to_rest(dynamics: DoubleIntegrator | Unicycle) -> None:
    """They end at rest at the place, keep the limits, and braking after any stays on the way."""
    generator = np.random.default_rng(1)
    for length_m in (0.01, 0.3, 2.0, 7.0, 40.0):
        for step_s in (0.5, 2.0):
            angle, heading = generator.uniform(-3.1, 3.1, 2)
            along = np.array([np.cos(angle), np.sin(angle)])
            rest = np.zeros(2) if isinstance(dynamics, DoubleIntegrator) else [heading]
            state = np.concatenate([[1.0, -2.0], rest])
            end = state[:2] + length_m * along
            inputs = dynamics.straight(state, end, step_s)
            drive = rolled_out(dynamics, state, inputs, step_s)
            assert drive.positions_m[-1] == pytest.approx(end, abs=1e-9)
            assert dynamics.stop_steps(drive.states[-1], step_s) == 0
            assert dynamics.excess_m(drive.states, drive.inputs, step_s) <= 1e-9
            for at in drive.states:
                steps = dynamics.longest_stop_steps(step_s) + 1
                braked = rolled_out(dynamics, at, dynamics.braking(at, step_s, steps), step_s)
                stop = braked.positions_m[-1] - state[:2]
                assert abs(stop @ [-along[1], along[0]]) <= 1e-9
                assert -1e-9 <= stop @ along <= length_m + 1e-9


def behind_a_hole(folder: Path, robot: str) -> Problem:
    """A strip of 60 m by 24 m behind a hole that spans it, with a wall to go round."""
    x = np.arange(0.5, 60.0)
    wall = [[29.0, 0.0], [31.0, 0.0], [31.0, 14.0], [29.0, 14.0]]
    return strip(
        folder,
        np.where((x > 20.0) & (x < 40.0), -100.0, -60.0),
        {"start_m": [5.0, 6.0], "goal_m": [55.0, 6.0], **ROBOTS[robot]},
        24.0,
        world={"bounds_m": [0.0, 0.0, 60.0, 24.0], "obstacles": [{"polygon": wall}]},
        stations=[{**STATION, "position_m": [30.0, 20.0]}],
        planner={"horizon": 4, "step_s": 1.0, "max_steps": 300},
    )


def left_m(scene: Scene, problem: Problem, place_m: np.ndarray) -> float:
    """Length of the shortest path over the lattice from a place to the goal."""
    nodes, lengths = first_moves(scene, problem, place_m)
    return float((lengths + scene.cost_to_go.cost_m[nodes]).min())


def driven_m(run: Run) -> float:
    """Length of the way of the run's robot, arcs taken by their chords."""
    return run.runs[0].metrics.path_m


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_run_through_a_hole_keeps_the_bound(robot: str, tmp_path: Path) -> None:
    """It arrives, far below (3 + 2 c) L."""
    problem = behind_a_hole(tmp_path, robot)
    scene = build_scene(problem)
    run = simulate(problem, scenes=[scene])
    assert run.runs[0].outcome.value == "reached"
    shortest_m = left_m(scene, problem, np.asarray(problem.robots[0].start_m))
    assert shortest_m - 2.0 <= driven_m(run) <= 1.5 * shortest_m
    assert driven_m(run) <= (3.0 + 2.0 * problem.reach.outage_price) * shortest_m


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_direct_run_drives_what_is_left(
    robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Made direct in motion, it stops, drives no more than what is left, and passes the check."""
    problem = behind_a_hole(tmp_path, robot)
    scene = build_scene(problem)
    monkeypatch.setattr(GlobalSearch, "_has_wandered", lambda _, history: history.steps >= 3)
    run = simulate(problem, scenes=[scene])
    log = run.runs[0].log
    assert run.runs[0].outcome.value == "reached"
    assert all(rung in (Rung.DIRECT, Rung.SHIFTED) for rung in log.rung[4:])
    places = log.positions_m
    legs = np.linalg.norm(np.diff(places, axis=0), axis=1)
    # It decides where it stands; what is left of the last plan, and braking, come first.
    decides = np.ones(len(places), dtype=bool)
    drive, dynamics = run.runs[0].drive, problem.robots[0].dynamics
    if isinstance(dynamics, DoubleIntegrator) and drive is not None:
        decides = np.linalg.norm(drive.states[:, 2:], axis=1) < 1e-9
        takes = problem.planner.horizon + dynamics.longest_stop_steps(problem.planner.step_s)
        assert decides[3 : 4 + takes].any()
    deciding = [step for step in range(3, len(legs)) if decides[step]]
    assert len(deciding) >= 5
    run.save(tmp_path / "run")
    assert check(tmp_path / "run").reasons == ()
    for step in deciding:
        assert legs[step:].sum() <= left_m(scene, problem, places[step]) + 1e-6
