"""What it costs a robot that cannot turn or stop at will to reach a goal, for CasADi and NumPy.

With the state x_k = (q_k, r_k), its resting place s(x_k), and turning(x, pivot) the time before it
drives towards the pivot, of the dynamics::

    effort sum |q_k - q_{k-1}|^2
        + sum c_k (rate |s(x_k) - pivot| + braking |s(x_k) - q_k| + turning(x_k, pivot))

c_N is 1: that is the way beyond the horizon. Where the pivot is come to within the horizon, every
step is charged besides, or arriving late would cost nothing. Charged from where the robot would
come to stand, it accelerates and brakes as late as it can: past the pivot there is nothing to gain.
Braking is the price of outage on the way to that place: free, a robot would put off what is dear
until after the horizon, again and again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.planning.programme.motion_rows import TINY, MotionShape
from planopt.robots.dynamics import Components

ROUNDING_STEPS = 0.01
"""Rounding of the distance to the pivot, in longest steps, so that its gradient exists there."""

PARAMETERS = 7
"""Numbers of a charge."""


@dataclass(frozen=True)
class GoalCharge:
    """The numbers of the cost.

    Attributes
    ----------
    pivot_m
        ``(2,)``.
    effort_s_m2, rate_s_m, braking_s_m
        Cost of squared step length, of a metre beyond the horizon, and of a metre driven before it
        comes to stand.
    each_step
        What c_k is besides, for every k: 0 where the pivot is not come to.
    rounding_m
        Of the distance to the pivot.
    """

    pivot_m: NDArray[np.float64]
    effort_s_m2: float
    rate_s_m: float
    braking_s_m: float
    each_step: float
    rounding_m: float

    @property
    def numbers(self) -> NDArray[np.float64]:
        """``(7,)`` as :func:`goal_cost_s` takes them."""
        costs = (self.effort_s_m2, self.rate_s_m, self.braking_s_m)
        return np.array([*self.pivot_m, *costs, self.each_step, self.rounding_m])


def goal_cost_s(shape: MotionShape, q: Any, w: Any, start: Components, charge: Any) -> Any:
    """The cost of positions `q` and variables `w`.

    Parameters
    ----------
    shape, q, w, start
        As for :func:`planopt.planning.programme.motion_rows.motion_rows`.
    charge
        The numbers of a `GoalCharge`.
    """
    pivot = (charge[0], charge[1])
    effort, rate, braking, each_step, rounding = (charge[i] for i in range(2, PARAMETERS))
    before, cost = start, 0.0
    for k in range(shape.horizon):
        own = (w[k * shape.per_step + i] for i in range(shape.rest))
        here = (q[2 * k], q[2 * k + 1], *own)
        x, y = shape.dynamics.resting_place(here)
        square = (x - pivot[0]) ** 2 + (y - pivot[1]) ** 2
        braked = (x - here[0]) ** 2 + (y - here[1]) ** 2
        ahead = rate * (square + rounding**2) ** 0.5 + shape.dynamics.turning_s(here, pivot)
        ahead = ahead + braking * (braked + rounding**2) ** 0.5
        weight = each_step + 1.0 if k == shape.horizon - 1 else each_step
        driven = (here[0] - before[0]) ** 2 + (here[1] - before[1]) ** 2
        cost = cost + effort * driven + weight * ahead
        before = here
    return cost


def goal_cost_gradient(
    shape: MotionShape,
    positions_m: NDArray[np.float64],
    w: NDArray[np.float64],
    start: NDArray[np.float64],
    charge: GoalCharge,
) -> NDArray[np.float64]:
    """Gradient (2 N + len(w),) of the cost by complex steps, without CasADi."""
    variables = np.concatenate([positions_m.ravel(), w])
    stepped = variables[:, None] + 1j * TINY * np.eye(len(variables))
    places = positions_m.size
    cost = goal_cost_s(shape, stepped[:places], stepped[places:], tuple(start), charge.numbers)
    return np.imag(cost) / TINY
