"""Robots that make room: a lane that a cart sweeps, with one robot in the other's way out."""

import pytest
from apart_scene import apart_problem

import planopt.planning.team.team_step as team_step
from planopt.planning.loop.closed_loop import simulate

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
    """Least distance of the two robots."""
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
