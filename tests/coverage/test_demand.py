"""How many agents an event asks for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planopt.coverage.assignment import (
    Demand,
    accuracy_demand,
    capped_demand,
    demanded,
    table_demand,
    trade_off_demand,
)
from planopt.coverage.localisation import EventSensor
from planopt.errors import InputError


@pytest.mark.parametrize(
    "demand",
    [
        table_demand({3: 1, 8: 4, 20: 5}),
        capped_demand(0.3, 6, 4),
        accuracy_demand(EventSensor(0.1, 1.0), 0.1),
        trade_off_demand(100.0, 2.0, 1.0, 3.0),
    ],
)
def test_never_more_than_there_are(demand: Demand) -> None:
    """Every kind stays between 0 and n, and never falls as n grows."""
    wanted = [demanded(demand, n) for n in range(1, 200)]
    assert all(0 <= p <= n for n, p in enumerate(wanted, start=1))
    assert wanted == sorted(wanted)


def test_caps() -> None:
    """The smallest of the share, the cap and what coverage leaves."""
    demand = capped_demand(0.3, 6, 4)
    assert [demand(n) for n in (1, 4, 5, 10, 11, 19, 50)] == [0, 0, 1, 3, 4, 6, 6]


def test_accuracy_meets_its_bound() -> None:
    """The number is the least whose Cramer-Rao bound on an equal-angle ring is small enough."""
    noise, strength, wanted = 0.05, 2.0, 0.04
    demand = accuracy_demand(EventSensor(noise, strength), wanted)
    slope = 9.0 * strength / (8.0 * math.sqrt(3.0))

    def error_m2(agents: int) -> float:
        turn = np.arange(agents) * (0.5 * np.pi if agents == 2 else 2.0 * np.pi / agents)
        away = np.stack((np.cos(turn), np.sin(turn)), axis=1)
        return float(np.trace(np.linalg.inv(slope**2 / noise**2 * away.T @ away)))

    least = next(p for p in range(2, 100) if error_m2(p) <= wanted**2)
    assert demand(1000) == least == 4
    assert demand(3) == 3
    assert accuracy_demand(EventSensor(noise, strength), wanted, measurements=4)(1000) == 2


def test_trade_off_is_the_minimum() -> None:
    """No other whole number gives less."""
    for area, kappa, w_c, w_s in (
        (100.0, 2.0, 1.0, 3.0),
        (5.0, 9.0, 0.1, 2.0),
        (1.0, 1.0, 1.0, 1e-4),
    ):
        demand = trade_off_demand(area, kappa, w_c, w_s)
        for n in range(2, 60):
            costs = [
                w_c * 5.0 / (18.0 * math.sqrt(3.0)) * area**2 / (n - p) + w_s * kappa / p
                for p in range(1, n)
            ]
            assert costs[demand(n) - 1] == pytest.approx(min(costs), rel=1e-12)


def test_functions_of_the_users_own() -> None:
    """A function is checked where it is asked."""
    assert demanded(lambda n: n // 2, 9) == 4
    for bad in (lambda n: n + 1, lambda n: -1, lambda n: 0.5):
        with pytest.raises(InputError, match="demand"):
            demanded(bad, 3)
