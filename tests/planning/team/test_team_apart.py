"""Robots that keep apart from each other and from what moves, in plans and in closed loop."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from apart_scene import CART, apart_problem

from planopt.planning.loop.closed_loop import simulate
from planopt.planning.plan import Rung
from planopt.planning.solve import solve
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M

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
