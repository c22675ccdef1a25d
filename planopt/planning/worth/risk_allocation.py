"""Share a risk out among the steps of a plan, and again by what each step used (equation 5.6).

That all steps are connected with probability p holds if the steps' own risks sum up to 1 - p at
most (Boole), and often with more: along a path outages belong together. So the sum is a budget that
is corrected by the joint probability of the path that came out. Within it risk goes from the steps
that do not use theirs to those that do (Ono and Williams, iterative risk allocation, 2008).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

USED_SHARE = 0.9
"""A step that uses so much of its risk wants more."""

TAKEN_SHARE = 0.5
"""Of what a step does not use, so much is taken from it at a time."""

LARGEST_STEP = 4.0
"""The budget grows or shrinks at a time by this factor at most."""

LARGEST_RISK = 0.5
"""No step is allowed more: beyond, more risk would ask for less certain powers."""

AIMED_SHARE = 0.98
"""Between a path within the risk and one beyond, so much of what is left is aimed at."""


@dataclass(frozen=True, eq=False)
class Allocation:
    """Risks that were allowed to the steps, and what came out."""

    risk: NDArray[np.float64]  # (N,)
    found: float  # The risk that all steps together had


def next_allocation(
    tried: Sequence[Allocation], used: NDArray[np.float64], asked: float
) -> NDArray[np.float64]:
    """Risks of the steps for the next polish; ``(N,)``.

    Between the last allocation that kept the bound and the last that did not, once there are both:
    by the secant, or half-way where that does not change sides.
    """
    # Shapes: used (N,).
    within = [one for one in tried if one.found <= asked]
    beyond = [one for one in tried if one.found > asked]
    if not (within and beyond):
        return allocated_again(tried[-1].risk, used, asked, tried[-1].found)
    low, high = within[-1], beyond[-1]
    share = AIMED_SHARE * (asked - low.found) / (high.found - low.found)
    if len(tried) > 2 and (tried[-1].found > asked) == (tried[-2].found > asked):
        # The secant comes from one side only: halve.
        share = 0.5
    return low.risk + share * (high.risk - low.risk)


def allocated_again(
    risk: NDArray[np.float64], used: NDArray[np.float64], asked: float, found: float
) -> NDArray[np.float64]:
    """Risks with the budget corrected and shared out by what was used; ``(N,)``."""
    # Shapes: risk (N,); used (N,).
    factor = float(np.clip(asked / max(found, 1e-12), 1.0 / LARGEST_STEP, LARGEST_STEP))
    budget = factor * float(risk.sum())
    wanting = used >= USED_SHARE * risk
    kept = np.where(wanting, 0.0, risk - TAKEN_SHARE * np.maximum(risk - used, 0.0))
    if factor < 1.0:
        kept *= factor
    left = max(budget - float(kept.sum()), 0.0)
    share = left / max(int(wanting.sum()), 1)
    return np.clip(np.where(wanting, share, kept), 1e-9, LARGEST_RISK)
