"""The JSON objects of solved problems and of closed loops."""

import json
from dataclasses import replace

import numpy as np
import pytest

from planopt import Run, Solution
from planopt.files.tables import encoded
from planopt.files.writing import strict_text
from planopt.planning.files.result_json import (
    no_plan_json,
    no_run_json,
    released_plans_json,
    run_json,
    solution_json,
)

ASKED = {"problem", "horizon", "planner", "seed"}
SOLVE = ASKED | {
    *("termination", "verdict", "sense", "objective", "bound", "gap", "wall_s", "solve_s"),
    *("iterations", "certificate", "robots"),
}
SIMULATE = ASKED | {"outcome", "metrics", "rungs", "verified_rate", "step_s", "robots"}
CERTIFICATE = {
    *("min_clearance_m", "min_connectivity", "dynamics_defect", "kkt_residual", "posterior")
}


def test_keys_of_solve(solution: Solution) -> None:
    """Every key that other tools rely on, N + 1 places, and numbers to the last bit."""
    data = json.loads(strict_text(solution_json(solution)))
    assert set(data) >= SOLVE and set(data["certificate"]) >= CERTIFICATE
    assert (data["problem"], data["horizon"], data["seed"]) == ("open_field", 6, 0)
    assert data["sense"] == "min" and data["bound"] is None and data["gap"] is None
    robot = data["robots"][0]
    assert set(robot) >= {"name", "t_s", "x_m", "y_m", "connectivity", "verdict", "certificate"}
    assert len(robot["t_s"]) == len(robot["connectivity"]) == 7
    back = np.stack([robot["x_m"], robot["y_m"]], axis=1)
    assert np.array_equal(back, solution.plan.positions_m)


def test_keys_of_simulate(simulation: Run) -> None:
    """Every key that other tools rely on; the start takes no planning time."""
    log = replace(simulation.run.log, step_s=np.arange(9.0))
    data = run_json(replace(simulation, runs=(replace(simulation.run, log=log),)))
    strict_text(data)
    assert set(data) >= SIMULATE
    assert data["outcome"] == "step_limit" and data["metrics"]["goal_time_s"] is None
    assert sum(data["rungs"].values()) == 8
    assert len(data["robots"][0]["x_m"]) == 9
    assert data["step_s"] == {"p50": 4.5, "p95": pytest.approx(7.65), "max": 8.0}


def test_released_plans_are_whole(simulation: Run) -> None:
    """Each released plan has its N + 1 places; the robot drove to the second."""
    [plans] = [one["released"] for one in released_plans_json(simulation)]
    track = simulation.run.log.positions_m
    assert len(plans) == 8
    for step, plan in enumerate(plans, start=1):
        assert len(plan["x_m"]) == len(plan["y_m"]) == 5
        assert [plan["x_m"][1], plan["y_m"][1]] == track[step].tolist()


def test_infinite_clearance_is_null(solution: Solution) -> None:
    """Without obstacles the clearance is infinite, for which JSON has no number."""
    certificate = replace(solution.plan.certificate, min_clearance_m=np.inf, kkt_residual=None)
    plan = replace(solution.plan, certificate=certificate)
    data = json.loads(strict_text(solution_json(replace(solution, plans=(plan,)))))
    assert data["certificate"]["min_clearance_m"] is None
    assert data["certificate"]["kkt_residual"] is None


@pytest.mark.parametrize(
    ("lattice", "objective", "share"),
    [(8.0, 6.0, 0.25), (0.0, 0.0, 0.0), *((base, -5.0, None) for base in (0.0, 1e-9, -1e-9))],
)
def test_polish_gain(solution: Solution, lattice: float, objective: float, share: float) -> None:
    """The share of the lattice path's objective; null if that is next to nothing."""
    plan = replace(solution.plan, lattice_objective=lattice, objective=objective)
    data = solution_json(replace(solution, plans=(plan,)))
    assert data["polish_gain"] == data["robots"][0]["polish_gain"] == share


def test_no_result_has_the_same_keys(solution: Solution, simulation: Run) -> None:
    """Every key is there, null without a value."""
    there, none = solution_json(solution), no_plan_json(solution.problem, 7, "cut off")
    assert set(none) == set(there)
    assert set(none["certificate"]) == set(there["certificate"])
    assert none["verdict"] == "none" and none["message"] == "cut off" and none["seed"] == 7
    assert none["objective"] is None and none["robots"] == []
    strict_text(none)
    there, none = run_json(simulation), no_run_json(simulation.problem, 3, "cut off")
    assert set(none) == set(there) and set(none["metrics"]) == set(there["metrics"])
    assert none["outcome"] == "no_plan" and none["message"] == "cut off"
    assert none["step_s"] == {"p50": None, "p95": None, "max": None}
    strict_text(none)


def test_strictness() -> None:
    """Numbers that are not finite become null, and never get past `strict_text`."""
    assert encoded([None, np.nan, -np.inf, np.float64(1.5)]) == [None, None, None, 1.5]
    assert encoded(np.array([1.5, np.nan])) == [1.5, None]
    with pytest.raises(ValueError):
        strict_text({"x": np.nan})
