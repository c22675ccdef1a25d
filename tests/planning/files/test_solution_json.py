"""The JSON object of a solved problem."""

import json
from dataclasses import replace

import numpy as np
import pytest

from planopt import load
from planopt.files.whole import strict_text
from planopt.planning.files.solution_json import (
    finite,
    finite_list,
    no_plan_json,
    solution_json,
)
from planopt.planning.solution import Solution
from planopt.planning.solve import solve

CONTRACT = {
    "problem",
    "horizon",
    "planner",
    "seed",
    "termination",
    "verdict",
    "sense",
    "objective",
    "bound",
    "gap",
    "wall_s",
    "solve_s",
    "iterations",
    "certificate",
    "robots",
}
CERTIFICATE = {
    "min_clearance_m",
    "min_connectivity",
    "dynamics_defect",
    "kkt_residual",
    "posterior",
}


@pytest.fixture(scope="module")
def solution() -> Solution:
    """A plan of three steps in the open field."""
    return solve(load("open_field"), horizon=3)


def test_has_the_keys_of_the_contract(solution: Solution) -> None:
    """Every key that other tools rely on is there, and the arrays have N + 1 places."""
    data = solution_json(solution)
    assert set(data) >= CONTRACT
    assert set(data["certificate"]) >= CERTIFICATE
    assert (data["problem"], data["horizon"], data["seed"]) == ("open_field", 3, 0)
    assert data["sense"] == "min" and data["bound"] is None and data["gap"] is None
    robot = data["robots"][0]
    assert set(robot) >= {"name", "t_s", "x_m", "y_m", "connectivity", "verdict", "certificate"}
    assert [len(robot[key]) for key in ("t_s", "x_m", "y_m", "connectivity")] == [4] * 4


def test_numbers_survive_the_text(solution: Solution) -> None:
    """Positions come back from the text bit by bit."""
    data = json.loads(strict_text(solution_json(solution)))
    robot = data["robots"][0]
    back = np.stack([robot["x_m"], robot["y_m"]], axis=1)
    assert np.array_equal(back, solution.plan.positions_m)


def test_infinite_clearance_is_null(solution: Solution) -> None:
    """Without obstacles the clearance is infinite, for which JSON has no number."""
    certificate = replace(solution.plan.certificate, min_clearance_m=np.inf, kkt_residual=None)
    plan = replace(solution.plan, certificate=certificate)
    data = json.loads(strict_text(solution_json(replace(solution, plans=(plan,)))))
    assert data["certificate"]["min_clearance_m"] is None
    assert data["certificate"]["kkt_residual"] is None


def test_polish_gain_is_the_saved_share(solution: Solution) -> None:
    """A lattice cost of 8 polished to 6 is a gain of a quarter; of 0 there is none."""
    plan = replace(solution.plan, lattice_objective=8.0, objective=6.0)
    assert solution_json(replace(solution, plans=(plan,)))["polish_gain"] == 0.25
    plan = replace(solution.plan, lattice_objective=0.0, objective=0.0)
    assert solution_json(replace(solution, plans=(plan,)))["polish_gain"] == 0.0


@pytest.mark.parametrize("lattice", [0.0, 1e-9, -1e-9])
def test_a_gain_on_next_to_nothing_has_no_share(solution: Solution, lattice: float) -> None:
    """A lattice path that is worth almost nothing is no base: null, of a plan and of all."""
    plan = replace(solution.plan, lattice_objective=lattice, objective=-5.0)
    data = json.loads(strict_text(solution_json(replace(solution, plans=(plan,)))))
    assert data["polish_gain"] is None and data["robots"][0]["polish_gain"] is None


def test_no_plan_has_the_same_keys(solution: Solution) -> None:
    """Where there is no plan every key is there, null where there is nothing."""
    there, none = solution_json(solution), no_plan_json(solution.problem, 7, "cut off")
    assert set(none) == set(there)
    assert set(none["certificate"]) == set(there["certificate"])
    assert none["verdict"] == "none" and none["message"] == "cut off" and none["seed"] == 7
    assert none["objective"] is None and none["robots"] == []
    strict_text(none)


def test_strictness() -> None:
    """What is not finite becomes null by `finite`, and never gets past `strict_text`."""
    assert finite(None) is None and finite(np.nan) is None and finite(-np.inf) is None
    assert finite_list(np.array([1.5, np.nan])) == [1.5, None]
    with pytest.raises(ValueError):
        strict_text({"x": np.nan})
