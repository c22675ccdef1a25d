"""Plans through cells that change over the horizon."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scattered import scattered

import planopt
from planopt.coverage import (
    ConvexGround,
    ConvexRegion,
    Gains,
    Motion,
    MoveLimits,
    foreseen_aims,
    law_moves,
    plan_moves,
)
from planopt.problems.tasks import problem_from

HORIZON, GAIN = 6, 0.6
LIMITS = MoveLimits(speed_m_s=4.0)


def plan_cost(
    ground: ConvexGround, here_m: NDArray[np.float64], path_m: NDArray[np.float64], weights: object
) -> float:
    """The objective (7.15) of a plan, with the weights of its moves."""
    costs = [ground.cover(path_m[:, step]).cost for step in range(HORIZON)]
    moves = np.diff(path_m, axis=1, prepend=here_m[:, None])
    effort = (1.0 - GAIN) / GAIN**2 * (weights * (moves**2).sum(axis=(1, 2))).sum()
    return sum(costs[:-1]) + costs[-1] / GAIN + float(effort)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_an_iteration_never_raises_the_cost_of_a_plan(square: ConvexRegion, seed: int) -> None:
    """Proposition: plans to the centroids along a plan cost at most as much as that plan."""
    ground = ConvexGround(square)
    here = scattered(square, 30, np.random.default_rng(seed)) * 0.3
    nobody, share = np.zeros(30, dtype=np.bool_), np.full(30, GAIN)
    law = [here]
    for _ in range(HORIZON):
        ends = ground.cover(law[-1]).targets_m
        law.append(law_moves(law[-1], ends, nobody, Gains(1.0, GAIN), 1.0, LIMITS.speed_m_s))
    path, most_m = np.stack(law[1:], axis=1), LIMITS.speed_m_s
    ends = ground.cover(here).targets_m
    for kept in (path[:, :0], path[:, :3]):  # The law extends plans that are too short
        aims = foreseen_aims(ground, here, ends, kept, nobody, HORIZON, share, most_m)
        for step in range(HORIZON):
            assert aims.places_m[:, step] == pytest.approx(ground.cover(path[:, step]).targets_m)
    for _ in range(4):
        weights = ground.cover(path[:, -1]).mass
        aims = foreseen_aims(ground, here, here, path, nobody, HORIZON, share, most_m)
        plan = plan_moves(ground, Motion.at_rest(here), aims, LIMITS, GAIN, HORIZON)
        before = plan_cost(ground, here, path, weights)
        after = plan_cost(ground, here, plan.paths_m, weights)
        assert after <= before * (1.0 + 1e-6)
        path = ground.nearest(plan.paths_m.reshape(-1, 2)).reshape(path.shape)
    assert after < 0.999 * plan_cost(ground, here, np.repeat(here[:, None], HORIZON, 1), weights)


@pytest.mark.parametrize("inert", [False, True])
def test_a_network_spreads_sooner_with_a_horizon(square: ConvexRegion, inert: bool) -> None:
    """Agents in a corner set out before those around them have moved; no move is at fault."""
    text = {
        "problem": {"schema": 1, "name": "corner", "task": "coverage"},
        "world": {"bounds_m": [0, 0, 60, 60]},
        "agents": {
            "start": {"kind": "random", "count": 12, "within_m": [0, 0, 15, 15]},
            "speed_max_m_s": 2.0,
            **({"acceleration_max_m_s2": 0.4} if inert else {}),
        },
        "changes": [{"agents": [3], "joins_s": 4.0}, {"agents": [7], "leaves_s": 9.0}],
        "control": {"duration_s": 150, "coverage_gain_per_s": 1.0},
        "planner": {"name": "receding"},
    }
    problem = problem_from(text, folder=Path(), file=None)
    one, many = (planopt.simulate(problem, seed=6, horizon=each).data for each in (1, 5))
    assert one["faults"] == many["faults"] == [] and many["outcome"] == "settled"
    assert many["metrics"]["settled_s"] < (one["metrics"]["settled_s"] or 150.0)
