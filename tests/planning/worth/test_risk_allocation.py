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
from planopt.planning.worth.rule_rows import fewest_held


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


def test_fewest_held_leaves_no_run_too_long():
    """Against all subsets of five steps, where enough steps can be held for nothing."""
    generator = np.random.default_rng(2)
    for _ in range(20):
        sizes = generator.uniform(0.5, 2.0, 5)
        before, limit = generator.uniform(0.0, 2.0), generator.uniform(2.0, 5.0)
        held = fewest_held(sizes, np.ones(5, dtype=bool), limit, before)
        fewest = min(
            bin(mask).count("1")
            for mask in range(32)
            if _keeps(sizes, np.array([bool(mask >> k & 1) for k in range(5)]), limit, before)
        )
        assert _keeps(sizes, held, limit, before)
        assert held.sum() == fewest


def test_steps_that_the_path_keeps_are_held_first():
    """The last of them before the run would be too long."""
    keeps = np.array([True, True, False, False, True])
    held = fewest_held(np.ones(5), keeps, limit=2.0, before=0.0)
    assert held.tolist() == [False, True, False, False, True]


def _keeps(sizes, held, limit, before):
    run = before
    for size, is_held in zip(sizes, held, strict=True):
        run = 0.0 if is_held else run + size
        if run > limit and not is_held:
            return False
    return True
