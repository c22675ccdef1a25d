"""Robots that keep apart from each other and from what moves, in plans and in closed loop."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from apart_scene import CART, apart_problem

from planopt.planning.loop.closed_loop import simulate
from planopt.planning.plan import Rung, Verdict
from planopt.planning.solve import solve
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.world.moving_discs import centres_at

SHARES = np.linspace(0.0, 1.0, 201)


def sampled_m(path_m):
    """Places of a path at many equal times."""
    times = np.concatenate([k + SHARES for k in range(len(path_m) - 1)])
    return np.stack([np.interp(times, range(len(path_m)), path_m[:, a]) for a in (0, 1)], axis=1)


def least_apart_m(paths_m):
    """Least distance of any two at equal times, by samples."""
    return min(
        np.linalg.norm(sampled_m(a) - sampled_m(b), axis=1).min()
        for a, b in combinations(paths_m, 2)
    )


def random_scene(seed):
    """Two to four robots and up to two carts, anywhere."""
    generator = np.random.default_rng(seed)
    separation = float(generator.uniform(1.0, 3.5))
    starts: list[tuple[float, float]] = []
    while len(starts) < 2 + seed % 3:
        x, y = generator.uniform(2.0, 38.0, 2).tolist()
        blocked = 17.0 < x < 23.0 and 11.0 < y < 29.0
        if not blocked and all(np.hypot(x - a, y - b) > separation for a, b in starts):
            starts.append((x, y))
    carts = []
    while len(carts) < seed % 4 // 2 + seed % 2:
        place = generator.uniform(0.0, 40.0, 2)
        if all(np.hypot(*(place - start)) > 4.0 for start in starts):
            velocity = generator.uniform(-1.0, 1.0, 2).tolist()
            cart = {"name": f"cart{len(carts)}", "radius_m": 1.0, "velocity_m_s": velocity}
            carts.append({**cart, "start_m": place.tolist()})
    names = ("auto", "lattice", "one_step", "random", "auto")
    return apart_problem(
        starts,
        tuple(carts),
        separation,
        learns=bool(seed % 2),
        max_steps=6,
        horizon=4,
        name=names[seed % 5],
    )


@pytest.mark.parametrize("seed", range(10))
def test_no_released_step_is_nearer_than_the_separation(seed):
    """Whatever the planner, the rung and the verdict; certificates say how near."""
    problem = random_scene(seed)
    run = simulate(problem, seed=seed)
    separation = problem.constraints.separation_m
    tracks = [one.log.positions_m for one in run.runs]
    assert least_apart_m(tracks) >= separation - CLEARANCE_TOLERANCE_M
    for made in zip(*run.plans, strict=True):
        least = least_apart_m([plan.positions_m for plan in made])
        assert least >= separation - CLEARANCE_TOLERANCE_M
        said = min(plan.certificate.min_separation_m for plan in made)
        assert said == pytest.approx(least, abs=0.05)
        assert said <= least + 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_verified_steps_keep_clear_of_moving_obstacles(seed):
    """Against the obstacle itself, at many times."""
    problem = apart_problem([(10, 15), (14, 15)], max_steps=8, horizon=5)
    run = simulate(problem, seed=seed)
    (cart,) = problem.workspace.moving
    for one, plans in zip(run.runs, run.plans, strict=True):
        times = np.concatenate([k + SHARES for k in range(len(plans))])
        away = np.linalg.norm(sampled_m(one.log.positions_m) - centres_at(cart, times), axis=1)
        verified = np.repeat([plan.verdict is Verdict.VERIFIED for plan in plans], len(SHARES))
        assert verified.any()
        assert away[verified].min() >= cart.radius_m + 0.5 - CLEARANCE_TOLERANCE_M
    assert run.verified_rate > 0.9


def test_they_would_meet_if_they_were_not_kept_apart():
    """Without the constraint both go to the target, nearer than the separation would let them."""
    problem = apart_problem([(10, 15), (14, 15)], (), max_steps=8, horizon=5)
    free = replace(problem, constraints=replace(problem.constraints, separation_m=0.0))
    paths = [one.log.positions_m for one in simulate(free, seed=0).runs]
    assert least_apart_m(paths) < 2.0
    paths = [one.log.positions_m for one in simulate(problem, seed=0).runs]
    assert least_apart_m(paths) >= 3.0 - CLEARANCE_TOLERANCE_M


def test_far_things_change_nothing():
    """A cart far away, and robots farther apart than they must be, plan as if alone."""
    far = {**CART, "start_m": [5000.0, 20.0]}
    starts = [(4.0, 6.0), (36.0, 6.0)]
    plain = solve(apart_problem(starts, (), 0.0, horizon=3), seed=2)
    beside = solve(apart_problem(starts, (far,), 0.0, horizon=3), seed=2)
    apart = solve(apart_problem(starts, (), 0.5, horizon=3), seed=2)
    for other in (beside, apart):
        for one, two in zip(plain.plans, other.plans, strict=True):
            # Rows that bind nothing still move the solver's last digits.
            np.testing.assert_allclose(one.positions_m, two.positions_m, atol=2e-3)
            assert two.objective == pytest.approx(one.objective, rel=1e-5)
    assert beside.plans[0].certificate.min_moving_clearance_m > 4900.0
    assert plain.plans[0].certificate.min_separation_m is None
    assert apart.plans[0].certificate.min_separation_m > 20.0


def test_the_same_seed_is_the_same_run():
    """Bit for bit."""
    problem = apart_problem([(10, 15), (14, 15), (10, 22)], max_steps=4, horizon=4)
    one, two = (simulate(problem, seed=3) for _ in range(2))
    for a, b in zip(one.runs, two.runs, strict=True):
        assert (a.log.positions_m == b.log.positions_m).all()


def test_the_last_resort_is_what_the_others_keep_clear_of():
    """A robot whose planner finds nothing goes on as reserved, and nobody is in its way."""
    problem = apart_problem([(10, 15), (14, 15), (10, 22)], max_steps=12, horizon=6)
    run = simulate(problem, seed=0)
    for number, plans in enumerate(run.plans):
        for step, plan in enumerate(plans):
            if plan.rung is Rung.RESERVED:
                before = run.plans[number][step - 1].positions_m
                np.testing.assert_array_equal(plan.positions_m[:-1], before[1:])
    assert least_apart_m([one.log.positions_m for one in run.runs]) >= 3.0 - 1e-6


@pytest.mark.parametrize("horizon", [1, 2])
def test_short_horizons_keep_apart_too(horizon):
    """One step ahead there is nothing to reserve but standing still."""
    problem = apart_problem([(10, 15), (13.5, 15), (10, 19)], max_steps=6, horizon=horizon)
    run = simulate(problem, seed=1)
    assert run.metrics["min_separation_m"] >= 3.0 - CLEARANCE_TOLERANCE_M
    tracks = [one.log.positions_m for one in run.runs]
    assert run.metrics["min_separation_m"] == pytest.approx(least_apart_m(tracks), abs=0.05)
