"""One step of a team: room for each other, plans of a run, several stations."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from apart_scene import apart_problem
from team_scene import two_trackers
from terms_scene import CONNECT, LEARNING, TRACKING, context_of, own_term, terms_problem

import planopt.planning.proof.rule as predictions
from planopt import Verdict, check
from planopt.channel import true_power_dbm
from planopt.channel.connectivity_law import serving_power_dbm
from planopt.objectives.terms.term import Aim
from planopt.planning.files.belief_file import BELIEF_FILE
from planopt.planning.files.result_json import solution_json
from planopt.planning.initial_data import team_seeds
from planopt.planning.solve import simulate, solve
from planopt.planning.team import team_step
from planopt.planning.team.team_step import build_team
from planopt.planning.values.objective_value import ObjectiveValue

LANE = [
    {"polygon": [[0.0, 10.0], [40.0, 10.0], [40.0, 19.0], [0.0, 19.0]]},
    {"polygon": [[0.0, 21.0], [40.0, 21.0], [40.0, 30.0], [0.0, 30.0]]},
]
SWEEPER = {"name": "sweeper", "radius_m": 0.4, "start_m": [5.0, 20.0], "velocity_m_s": [1.5, 0.0]}


def lane_problem(starts_m=((10.0, 20.0), (14.0, 20.0)), **planner):
    """Two robots in a lane too narrow to pass the sweeper, or each other."""
    settings = {"horizon": 5, "max_steps": 8, **planner}
    return apart_problem(list(starts_m), (SWEEPER,), 3.0, obstacles=LANE, **settings)


def least_m(run):
    return run.metrics["min_separation_m"]


def test_the_one_in_the_way_makes_room():
    """The first to plan is swept towards the other, who stands there until it is asked second."""
    run = simulate(lane_problem(), seed=0)
    assert run.verified_rate == 1.0
    assert least_m(run) >= 3.0 - 1e-6
    assert run.metrics["min_moving_clearance_m"] >= 0.5 - 1e-6
    ahead = [one.log.positions_m[-1, 0] for one in run.runs]
    assert 5.0 + 8 * 1.5 < ahead[0] < ahead[1]


def test_without_making_room_it_is_owned_up_to(monkeypatch: pytest.MonkeyPatch):
    """Robots never come nearer to each other, but the sweeper comes too near to one of them."""
    monkeypatch.setattr(team_step, "_verified", lambda _plans: 0)
    run = simulate(lane_problem(), seed=0)
    assert least_m(run) >= 3.0 - 1e-6
    assert run.verified_rate < 1.0
    reasons = [r for plans in run.plans for plan in plans for r in plan.certificate.reasons]
    assert any("of the moving obstacle sweeper" in reason for reason in reasons)
    assert not any("of the robot" in reason for reason in reasons)


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


def connected(path: Any) -> Any:
    """An expression of one's own: connected as often as may be."""
    import casadi as ca

    return ca.sum1(path.connectivity)


CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "track": (TRACKING, {"p_min": 0.8}),
    "recourse": ({**TRACKING, "form": "recourse"}, {}),
    "connect": (CONNECT, {}),
    "learn": (LEARNING, {}),
    "map": ({"kind": "mapping", "form": "information"}, {}),
    "own": (own_term(connected, 3), {"p_min": 0.8}),
    "one step": (TRACKING, {"name": "one_step"}),
}


@pytest.mark.parametrize("case", CASES)
def test_a_run_is_verified_and_judged_again(case: str, tmp_path: Path) -> None:
    """What was driven was connected to whichever station was the better one."""
    term, planner = CASES[case]
    problem = terms_problem(term, stations=2, horizon=3, max_steps=2, **planner)
    run = simulate(problem, seed=1)
    assert run.verified_rate == 1.0
    log = run.runs[0].log
    powers = [true_power_dbm(t, log.positions_m) for t in run.truths]
    thresholds = [radio.threshold_dbm for radio in problem.stations]
    assert np.array_equal(log.true_dbm, serving_power_dbm(np.stack(powers), thresholds))
    any_of_them = (np.stack(powers) >= np.array(thresholds)[:, None]).any(axis=0)
    assert np.array_equal(log.connected, any_of_them)
    run.save(tmp_path)
    assert check(tmp_path).reasons == ()
    with np.load(tmp_path / BELIEF_FILE) as archive:
        arrays = {name: archive[name] for name in archive}
    arrays["stations[1].power_dbm"][-1] += 0.5
    np.savez_compressed(tmp_path / BELIEF_FILE, **arrays)
    assert any("stations[1].power_dbm" in reason for reason in check(tmp_path).reasons)


@pytest.mark.parametrize("name", ["auto", "lattice", "one_step"])
def test_the_objective_is_the_paths_own(name, monkeypatch):
    """With few neighbours a place, grouped with others than the path's in the search."""
    for module in (predictions, team_step):
        monkeypatch.setattr(module, "SEARCH_EXACT_LIMIT", 10)
    monkeypatch.setattr(predictions, "SEARCH_NEIGHBOURS", 6)
    problem = terms_problem(TRACKING, name=name, p_min=0.6)
    situation, belief = context_of(problem)
    member = build_team(problem, team_seeds(problem, 0))[0]
    plan, _ = member.plan(belief, member.start, Aim(situation.aim.target_m, None), None)
    alone, _ = context_of(problem)
    assert plan.objective == pytest.approx(ObjectiveValue(alone)(plan.positions_m[1:]), rel=1e-12)
