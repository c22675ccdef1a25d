"""Several events: shares, matching and optima against enumeration and linear programmes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from planopt.coverage.assignment import (
    NONE,
    Assignment,
    deferred_acceptance,
    fair_shares,
    optimal_assignment,
    propagate_flags,
)
from planopt.coverage.network import Network
from planopt.errors import InputError


def drawn(seed: int, agents: int, demands: NDArray[np.intp]) -> NDArray[np.float64]:
    """Distances between random agents and events."""
    generator = np.random.default_rng(seed)
    places = generator.random((agents, 2)), generator.random((len(demands), 2))
    return np.linalg.norm(places[0][:, None] - places[1], axis=2)


def counts(found: Assignment, events: int) -> list[int]:
    """How many respond to each event."""
    return np.bincount(found.event_of[found.event_of != NONE], minlength=events).tolist()


def test_shares_by_enumeration() -> None:
    """Shares are the best in the order of the smallest, the second smallest, and so on."""
    for demands in itertools.product(range(1, 5), repeat=3):
        for agents in range(sum(demands) + 2):
            used = min(agents, sum(demands))
            best = max(
                sorted(g / d for g, d in zip(given, demands, strict=True))
                for given in itertools.product(*(range(d + 1) for d in demands))
                if sum(given) == used
            )
            found = fair_shares(np.array(demands), agents)
            assert found.sum() == used and (found <= demands).all()
            assert sorted(found / np.array(demands)) == best
    assert fair_shares(np.array([0, 3]), 2).tolist() == [0, 2]
    assert fair_shares(np.array([], dtype=np.intp), 5).tolist() == []


@pytest.mark.parametrize("seed", range(15))
def test_matching_is_stable(seed: int) -> None:
    """Demands are met, and no agent and event would both rather have each other."""
    generator = np.random.default_rng(seed)
    demands = generator.integers(0, 6, size=int(generator.integers(1, 5)))
    agents = int(demands.sum() + generator.integers(1, 10))
    distances = drawn(100 + seed, agents, demands)
    found = deferred_acceptance(distances, demands)
    assert counts(found, len(demands)) == demands.tolist()
    own = np.where(found.event_of == NONE, np.inf, 0.0)
    sent = found.event_of != NONE
    own[sent] = distances[sent, found.event_of[sent]]
    for event in range(len(demands)):
        team = distances[found.event_of == event, event]
        worst = team.max() if len(team) else -np.inf
        blocking = (distances[:, event] < own) & (distances[:, event] < worst)
        assert not blocking.any()
    assert found.released <= agents * len(demands)
    assert found.asked == demands.sum() + found.released


def test_matching_is_what_lists_give() -> None:
    """Flag lists for each event, with agents leaving the farther ones, end in the same matching."""
    demands = np.array([4, 3, 5])
    for seed in range(10):
        distances = drawn(seed, 20, demands)
        complete = Network(20, np.array(list(itertools.combinations(range(20), 2))))
        open_ = distances.copy()
        while True:
            flags = np.stack(
                [propagate_flags(complete, open_[:, k], int(demands[k])).flagged for k in range(3)],
                axis=1,
            )
            twice = flags.sum(axis=1) > 1
            if not twice.any():
                break
            for agent in np.flatnonzero(twice):
                best = np.where(flags[agent], distances[agent], np.inf).argmin()
                leave = flags[agent] & (np.arange(3) != best)
                open_[agent, leave] = 1e9
        event_of = np.where(flags.any(axis=1), flags.argmax(axis=1), NONE)
        assert (deferred_acceptance(distances, demands).event_of == event_of).all()


@pytest.mark.parametrize("seed", range(6))
def test_optimum_is_that_of_the_linear_programme(seed: int) -> None:
    """The programme's optimum is integral and costs what the assignment does."""
    demands = np.array([2, 3, 1])
    distances = drawn(seed, 9, demands)
    found = optimal_assignment(distances, demands)
    once = np.kron(np.eye(9), np.ones(3))
    met = np.kron(np.ones(9), np.eye(3))
    programme = linprog(
        distances.ravel(), A_ub=once, b_ub=np.ones(9), A_eq=met, b_eq=demands, method="highs-ds"
    )
    assert found.total_m == pytest.approx(programme.fun)
    assert programme.x == pytest.approx(np.round(programme.x))
    assert counts(found, 3) == demands.tolist()
    greedy = deferred_acceptance(distances, demands)
    assert greedy.total_m >= found.total_m * (1.0 - 1e-12)


def test_gap_by_hand() -> None:
    """The nearest agent goes to the nearer event, and the other one pays for it."""
    distances = np.array([[1.0, 1.1], [1.2, 9.0]])
    demands = np.array([1, 1])
    stable, best = deferred_acceptance(distances, demands), optimal_assignment(distances, demands)
    assert stable.event_of.tolist() == [0, 1]
    assert best.event_of.tolist() == [1, 0]
    assert (stable.total_m, best.total_m) == pytest.approx((10.0, 2.3))


def test_one_event_is_best_served_by_the_nearest() -> None:
    """For one event matching and optimum give the P nearest agents."""
    distances = drawn(9, 12, np.array([1]))
    demand = np.array([5])
    near = np.argsort(distances[:, 0])[:5]
    for found in (deferred_acceptance(distances, demand), optimal_assignment(distances, demand)):
        assert set(np.flatnonzero(found.event_of == 0)) == set(near)


def test_no_events_and_bad_input() -> None:
    """Without events or demands nobody is assigned; wrong shapes and numbers are errors."""
    nothing = np.array([], dtype=np.intp)
    for method in (deferred_acceptance, optimal_assignment):
        assert (method(np.zeros((3, 0)), nothing).event_of == NONE).all()
        assert (method(np.ones((3, 1)), np.array([0])).event_of == NONE).all()
        for distances, demands in (
            (np.ones((3, 2)), np.array([1])),
            (np.ones((3, 2)), np.array([2, 2])),
            (np.ones((3, 2)), np.array([-1, 2])),
            (np.full((3, 1), np.nan), np.array([1])),
        ):
            with pytest.raises(InputError):
                method(distances, demands)
