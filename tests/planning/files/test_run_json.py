"""The JSON object of a closed loop."""

from dataclasses import replace

import numpy as np
import pytest

from planopt import load
from planopt.files.whole import strict_text
from planopt.planning.files.run_json import no_run_json, released_plans_json, run_json
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.run import Run

CONTRACT = {
    "problem",
    "horizon",
    "planner",
    "seed",
    "outcome",
    "metrics",
    "rungs",
    "verified_rate",
    "step_s",
    "robots",
}


@pytest.fixture(scope="module")
def simulation() -> Run:
    """Four steps of the open field."""
    problem = load("open_field")
    short = replace(problem, planner=replace(problem.planner, max_steps=4))
    return simulate(short, horizon=5)


def test_has_the_keys_of_the_contract(simulation: Run) -> None:
    """Every key that other tools rely on is there, in strict JSON."""
    data = run_json(simulation)
    assert set(data) >= CONTRACT
    assert data["outcome"] == "step_limit" and data["metrics"]["goal_time_s"] is None
    assert sum(data["rungs"].values()) == 4
    assert len(data["robots"][0]["x_m"]) == 5
    strict_text(data)


def test_step_times_are_quantiles(simulation: Run) -> None:
    """The start, which took no planning, does not count."""
    log = replace(simulation.run.log, step_s=np.array([0.0, 1.0, 2.0, 3.0, 4.0]))
    changed = replace(simulation, runs=(replace(simulation.run, log=log),))
    step = run_json(changed)["step_s"]
    assert step == {"p50": 2.5, "p95": pytest.approx(3.85), "max": 4.0}


def test_released_plans_are_whole(simulation: Run) -> None:
    """Each released plan has its N + 1 places; the second is where the robot went."""
    [plans] = [one["released"] for one in released_plans_json(simulation)]
    track = simulation.run.log.positions_m
    assert len(plans) == 4
    for step, plan in enumerate(plans, start=1):
        assert len(plan["x_m"]) == len(plan["y_m"]) == 6
        assert [plan["x_m"][1], plan["y_m"][1]] == track[step].tolist()


def test_no_run_has_the_same_keys(simulation: Run) -> None:
    """Where there is no plan every key is there, null where there is nothing."""
    there, none = run_json(simulation), no_run_json(simulation.problem, 3, "cut off")
    assert set(none) == set(there) and set(none["metrics"]) == set(there["metrics"])
    assert none["outcome"] == "no_plan" and none["message"] == "cut off"
    assert none["step_s"] == {"p50": None, "p95": None, "max": None}
    strict_text(none)
