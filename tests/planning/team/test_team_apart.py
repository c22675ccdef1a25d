"""Robots that keep apart from each other and from moving obstacles, at all times."""

from itertools import combinations

import numpy as np
import pytest
from apart_scene import CART, apart_problem

from planopt import Problem, Verdict
from planopt.extend import Rung
from planopt.planning.solve import simulate, solve
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.robots.dynamics import rolled_out
from planopt.world import centres_at

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


PARTS = np.linspace(0.0, 1.0, 101)
BRAKING_STEPS = 8


def heavy(x: float, y: float, vx: float = 0.0, vy: float = 0.0) -> dict:
    return {
        "start_m": [x, y],
        "dynamics": "double_integrator",
        "acceleration_max_m_s2": 0.8,
        "start_velocity_m_s": [vx, vy],
    }


def wheels(x: float, y: float, heading: float = 0.0) -> dict:
    return {
        "start_m": [x, y],
        "dynamics": "unicycle",
        "turn_rate_max_rad_s": 1.0,
        "start_heading_rad": heading,
    }


def team(*robots: dict, moving=(CART,), separation=3.0, learns=False, **planner) -> Problem:
    """Robots of the small scene that track, or learn."""
    planner = {"horizon": 4, "max_steps": 6, **planner}
    return apart_problem(robots, moving, separation, learns, **planner)


def curve_sampled_m(path_m, drive, steps: int, braking: int = 0) -> np.ndarray:
    """Places at many equal times by integrating the models finely; standing after the last."""
    if drive is None:
        times = np.concatenate([k + PARTS for k in range(steps + braking)])
        return np.stack(
            [np.interp(times, range(len(path_m)), path_m[:, a]) for a in (0, 1)], axis=1
        )
    stop = drive.dynamics.braking(drive.states[steps], 1.0, braking)
    brakes = rolled_out(drive.dynamics, drive.states[steps], stop, 1.0)
    states = [*drive.states[:steps], *brakes.states[:-1]]
    inputs = [*drive.inputs[:steps], *stop]
    found = []
    for state, control in zip(states, inputs, strict=True):
        for share in PARTS:
            found.append(drive.dynamics.step(tuple(state), tuple(control), share)[:2])
    return np.array(found)


def curves_apart_m(ways) -> float:
    return min(np.linalg.norm(a - b, axis=1).min() for a, b in combinations(ways, 2))


def random_scene(seed: int) -> Problem:
    """Two or three robots of any dynamics, and a cart now and then."""
    generator = np.random.default_rng(seed)
    separation = float(generator.uniform(1.5, 3.5))
    robots: list[dict] = []
    while len(robots) < 2 + seed % 2:
        x, y = generator.uniform(6.0, 16.0), generator.uniform(12.0, 26.0)
        if all(
            np.hypot(x - r["start_m"][0], y - r["start_m"][1]) > separation + 1.0 for r in robots
        ):
            kind = generator.integers(3)
            if kind == 0:
                robots.append(heavy(x, y, *generator.uniform(-0.4, 0.4, 2).tolist()))
            elif kind == 1:
                robots.append(wheels(x, y, float(generator.uniform(-3.0, 3.0))))
            else:
                robots.append({"start_m": [x, y]})
    return team(
        *robots,
        moving=({**CART, "start_m": [2.0, 24.0]},) if seed % 3 else (),
        separation=separation,
        learns=seed % 4 == 3,
        name="lattice" if seed % 4 == 2 else "auto",
        max_steps=4,
    )


@pytest.mark.parametrize("seed", range(4))
def test_no_released_step_is_nearer_than_the_separation(seed: int) -> None:
    """Nor any plan, nor the braking after it, whatever the rung and the verdict."""
    problem = random_scene(seed)
    run = simulate(problem, seed=seed)
    asked = problem.constraints.separation_m - CLEARANCE_TOLERANCE_M
    steps, horizon = problem.planner.max_steps, problem.planner.horizon
    driven = [curve_sampled_m(one.log.positions_m, one.drive, steps) for one in run.runs]
    assert curves_apart_m(driven) >= asked
    said = run.metrics["min_separation_m"]
    assert said <= curves_apart_m(driven) + 1e-9
    assert said >= curves_apart_m(driven) - 0.05
    for made in zip(*run.plans, strict=True):
        ways = [curve_sampled_m(p.positions_m, p.drive, horizon, BRAKING_STEPS) for p in made]
        least = curves_apart_m(ways)
        assert least >= asked
        said = min(plan.certificate.min_separation_m for plan in made)
        assert least - 0.05 <= said <= least + 1e-9
    for cart in problem.workspace.moving:
        times = np.concatenate([k + PARTS for k in range(steps)])
        for way, plans in zip(driven, run.plans, strict=True):
            away = np.linalg.norm(way - centres_at(cart, times), axis=1) - cart.radius_m
            good = np.repeat([plan.verdict is Verdict.VERIFIED for plan in plans], len(PARTS))
            assert away[good].min(initial=np.inf) >= 0.5 - CLEARANCE_TOLERANCE_M
    assert run.verified_rate > 0.7


def test_they_would_meet_if_they_were_not_kept_apart() -> None:
    """Both go to the target, nearer than the separation would let them."""
    free = simulate(
        team(heavy(8, 15), wheels(12, 15), moving=(), separation=0.0, max_steps=8), seed=0
    )
    ways = [curve_sampled_m(one.log.positions_m, one.drive, 8) for one in free.runs]
    assert curves_apart_m(ways) < 2.0
