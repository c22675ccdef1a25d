"""Networks that drive to a deployment of low cost."""

from itertools import permutations

import numpy as np
import pytest
from scattered import scattered

import planopt
from planopt.coverage import ConvexGround, ConvexRegion, Deployer, settle


def test_assignment_has_the_least_squared_length(square: ConvexRegion) -> None:
    """Five agents get the positions of the best permutation, and keep them while they move."""
    ground, here = ConvexGround(square), scattered(square, 5, np.random.default_rng(3))
    deployer = Deployer(ground, np.random.default_rng(0))
    agents = np.arange(5)
    places = deployer.places_m(agents, here)
    lengths = [((places[list(order)] - here) ** 2).sum() for order in permutations(range(5))]
    assert ((places - here) ** 2).sum() == pytest.approx(min(lengths))
    np.testing.assert_array_equal(deployer.places_m(agents, 0.5 * (here + places)), places)


def test_agents_that_leave_and_return(square: ConvexRegion) -> None:
    """The others spread to a settled deployment of their own, and so do all of them afterwards."""
    ground, here = ConvexGround(square), scattered(square, 9, np.random.default_rng(4))
    deployer = Deployer(ground, np.random.default_rng(0))
    every = np.arange(9)
    whole = deployer.places_m(every, here)
    fewer = deployer.places_m(every[2:], whole[2:])
    cost = ground.cover(fewer).cost
    assert ground.cover(whole[2:]).cost > cost
    assert settle(ground, fewer)[1] == pytest.approx(cost, rel=1e-4)
    again = deployer.places_m(every, np.concatenate((whole[:2], fewer)))
    assert ground.cover(again).cost <= 1.02 * ground.cover(whole).cost


def test_it_ends_at_what_solve_finds() -> None:
    """Among obstacles the law ends above it, deploy does not, and every move is safe."""
    problem = planopt.load("coverage_obstacles")
    best = planopt.solve(problem, seed=11).data["objective"]
    runs = {
        name: planopt.simulate(problem, seed=11, planner=name).data for name in ("law", "deploy")
    }
    last = {name: run["metrics"]["cost_last"] for name, run in runs.items()}
    assert last["deploy"] <= 1.05 * best < last["law"]
    assert runs["deploy"]["outcome"] == "settled" and runs["deploy"]["faults"] == []
