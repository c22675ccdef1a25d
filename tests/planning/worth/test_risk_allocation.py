"""Risk allocation: budgets, who gives and who takes, and the search between two allocations."""

from __future__ import annotations

import numpy as np
import pytest

from planopt.planning.worth.risk_allocation import (
    LARGEST_RISK,
    Allocation,
    allocated_again,
    next_allocation,
)


def test_risk_goes_to_the_steps_that_use_it():
    """The budget stays, by Boole's count; unused risk moves."""
    risk, used = np.array([0.05, 0.05]), np.array([0.05, 0.01])
    again = allocated_again(risk, used, asked=0.1, found=0.1)
    assert again.sum() == pytest.approx(0.1)
    assert again[0] > 0.05 > again[1] >= used[1]


def test_budget_follows_what_all_steps_risk_together():
    """Twice the risk is allowed: twice the budget, and no step more than a half."""
    again = allocated_again(np.array([0.1, 0.1]), np.array([0.1, 0.1]), asked=0.2, found=0.1)
    assert again == pytest.approx([0.2, 0.2])
    most = allocated_again(np.array([0.4, 0.4]), np.array([0.4, 0.4]), asked=0.8, found=0.2)
    assert most.max() == LARGEST_RISK


def test_between_an_allocation_that_keeps_the_bound_and_one_that_does_not():
    """By the secant, a little on the safe side."""
    low, high = Allocation(np.array([0.1, 0.1]), 0.15), Allocation(np.array([0.2, 0.1]), 0.25)
    again = next_allocation([low, high], np.array([0.2, 0.1]), asked=0.2)
    assert again == pytest.approx([0.149, 0.1])


def test_a_secant_that_stays_on_one_side_is_halved():
    """Twice beyond: half-way to the allocation that kept the bound."""
    low = Allocation(np.array([0.1]), 0.15)
    beyond = [Allocation(np.array([0.4]), 0.26), Allocation(np.array([0.3]), 0.25)]
    again = next_allocation([low, *beyond], np.array([0.3]), asked=0.2)
    assert again == pytest.approx([0.2])
