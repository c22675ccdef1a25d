"""Plans of several robots, and the run that begins with them."""

import numpy as np
import pytest
from team_scene import two_trackers

from planopt.planning.files.result_json import solution_json
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.plan import Verdict
from planopt.planning.solve import solve


def test_a_run_begins_with_the_plans_of_a_solution() -> None:
    """Same seed, same belief, same expected target, same streams: the same plans."""
    problem = two_trackers()
    solution, run = solve(problem, seed=3), simulate(problem, seed=3)
    for plan, aim, made, known in zip(
        solution.plans, solution.aims, run.plans, run.aims, strict=True
    ):
        np.testing.assert_array_equal(plan.positions_m, made[0].positions_m)
        np.testing.assert_array_equal(aim.target_m, known[0].target_m)


def test_the_target_is_expected_where_its_first_estimate_moves() -> None:
    """Without measurements its expected way is straight and of even speed."""
    aim = solve(two_trackers(horizon=4), seed=1).aims[0]
    assert aim.target_m is not None and aim.steering_turns_m is None
    np.testing.assert_allclose(np.diff(aim.target_m, n=2, axis=0), 0.0, atol=1e-12)


def test_keys_are_sums_and_the_worst() -> None:
    """Objective, times and iterations add up; the certificate is the worst in each respect."""
    solution = solve(two_trackers(), seed=1)
    data = solution_json(solution)
    plans = solution.plans
    assert data["sense"] == "max" and data["bound"] is None
    assert data["objective"] == pytest.approx(sum(plan.objective for plan in plans))
    assert data["iterations"] == sum(plan.iterations for plan in plans)
    assert [robot["name"] for robot in data["robots"]] == ["robot", "second"]
    for key in ("min_clearance_m", "min_connectivity"):
        worst = min(robot["certificate"][key] for robot in data["robots"])
        assert data["certificate"][key] == worst
    assert data["verdict"] == solution.verdict.value == "verified"


def test_the_verdict_is_the_worst() -> None:
    """A robot that starts where the bound cannot be met makes the team's plans violated."""
    problem = two_trackers(p_min=0.999)
    low = problem.stations[0].__class__(**{**vars(problem.stations[0]), "threshold_dbm": 0.0})
    solution = solve(problem.__class__(**{**vars(problem), "stations": (low,)}))
    assert solution.verdict is Verdict.VIOLATED
    data = solution_json(solution)
    assert data["verdict"] == "violated" and data["message"].startswith("robot: ")
