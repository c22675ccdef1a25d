"""One robot on its way to a goal, and what crosses it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scenes import prepared_of, small_problem

from planopt.planning.loop.closed_loop import simulate
from planopt.planning.loop.log import Outcome
from planopt.planning.plan import Verdict
from planopt.problems.constraints import ConnectivityRule
from planopt.world.moving_discs import centres_at
from planopt.world.workspace import MovingObstacle

SHARES = np.linspace(0.0, 1.0, 201)
CROSSING = MovingObstacle("tram", 2.0, (0.0,), ((20.0, 5.0),), (0.0, 1.0))
ONCOMING = MovingObstacle("cart", 2.0, (0.0,), ((34.0, 15.0),), (-1.5, 0.0))
PARKING = MovingObstacle("van", 3.0, (0.0, 9.5, 20.0), ((25.0, 15.0), (20.0, 15.0), (20.0, 40.0)))
CORRIDOR = (shapely.box(8.0, 0.0, 32.0, 10.0), shapely.box(8.0, 20.0, 32.0, 30.0))


def driven(*moving, mirrored=False, polygons=(), **changes):
    """A run beside moving obstacles, and how near it came to each by samples."""
    problem = small_problem(*polygons, **changes)
    if mirrored:
        moving = tuple(
            replace(
                one,
                positions_m=tuple((x, 30.0 - y) for x, y in one.positions_m),
                velocity_m_s=(one.velocity_m_s[0], -one.velocity_m_s[1]),
            )
            for one in moving
        )
    problem = replace(problem, workspace=replace(problem.workspace, moving=moving))
    run = simulate(problem, prepared=prepared_of(problem))
    track = run.run.log.positions_m
    times = np.concatenate([k + SHARES for k in range(len(track) - 1)])
    places = np.stack([np.interp(times, range(len(track)), track[:, a]) for a in (0, 1)], axis=1)
    gaps = [
        np.linalg.norm(places - centres_at(one, times), axis=1).min() - one.radius_m
        for one in moving
    ]
    return run, gaps


@pytest.mark.parametrize("moving", [(CROSSING,), (ONCOMING,), (PARKING,), (CROSSING, ONCOMING)])
@pytest.mark.parametrize("planner", ["auto", "lattice"])
def test_the_goal_is_reached_past_what_moves(moving, planner):
    """Every step verified, and the clearance kept at all times."""
    run, gaps = driven(*moving, planner=planner)
    assert run.run.outcome is Outcome.REACHED
    assert all(plan.verdict is Verdict.VERIFIED for plan in run.plans[0])
    assert min(gaps) >= 0.5 - 1e-6
    least = min(plan.certificate.min_moving_clearance_m for plan in run.plans[0])
    assert 0.5 - 1e-6 <= least <= min(gaps) + 1e-6


def test_in_a_corridor_they_change_sides():
    """The only way leads past the oncoming cart, through the same corridor."""
    run, (gap,) = driven(ONCOMING, polygons=CORRIDOR, horizon=6)
    assert run.run.outcome is Outcome.REACHED
    assert gap >= 0.5 - 1e-6
    times = np.arange(len(run.run.log.t_s), dtype=float)
    ahead = centres_at(ONCOMING, times)[:, 0] - run.run.log.positions_m[:, 0]
    assert ahead[0] > 0.0 > ahead[-1]


def test_what_is_not_known_of_its_way_keeps_it_farther_away():
    """The certificate counts the disc as large as it is predicted."""
    unsure = replace(CROSSING, position_std_m=0.3, acceleration_std_m_s2=0.1)
    run, (gap,) = driven(unsure)
    assert run.run.outcome is Outcome.REACHED
    assert gap >= 0.5 + 0.3 * np.sqrt(-2.0 * np.log(0.005)) - 1e-6


def test_one_that_drives_over_a_robot_in_a_dead_end_is_owned_up_to():
    """Nothing can be verified; the certificate says what comes too near, and the run goes on."""
    cell = shapely.Polygon([(2, 2), (9, 2), (9, 8), (2, 8)], [[(4, 4), (6.5, 4), (6.5, 6), (4, 6)]])
    cart = MovingObstacle("press", 2.0, (0.0,), ((5.0, 12.0),), (0.0, -1.0))
    problem = small_problem(
        cell,
        bounds_m=(0.0, 0.0, 12.0, 12.0),
        start_m=(5.0, 5.0),
        goal_m=(5.5, 5.4),
        goal_radius_m=0.1,
        speed_max_m_s=0.2,
        max_steps=6,
        horizon=6,
    )
    problem = replace(problem, workspace=replace(problem.workspace, moving=(cart,)))
    run = simulate(problem, prepared=prepared_of(problem))
    assert any(
        "of the moving obstacle press" in reason
        for plan in run.plans[0]
        for reason in plan.certificate.reasons
    )
    assert run.run.verified_rate < 1.0


@pytest.mark.parametrize("planner", ["auto", "lattice"])
@pytest.mark.parametrize("form", ["joint", "average"])
def test_the_goal_is_reached_past_what_moves_under_a_rule(form, planner):
    """A rule that binds nowhere changes nothing of that."""
    problem = small_problem(planner=planner)
    rule = ConnectivityRule(form)
    constraints = replace(problem.constraints, p_min=1e-6, rule=rule)
    moving = (CROSSING, ONCOMING)
    workspace = replace(problem.workspace, moving=moving)
    problem = replace(problem, constraints=constraints, workspace=workspace)
    run = simulate(problem, prepared=prepared_of(problem))
    assert run.run.outcome is Outcome.REACHED
    assert all(plan.verdict is Verdict.VERIFIED for plan in run.plans[0])
