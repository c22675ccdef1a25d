# pyright: basic
"""Objective values with exact derivatives, and the cost of reaching a goal over N steps.

With step duration h, effort weight w, standard normal distribution Phi and smoothed step length
l_k = |q_k - q_{k-1}|, a path of a single integrator costs::

    w / h sum l_k^2 + rate |q_N - pivot| + price sum l_k (c_{k-1} + c_k) / 2

where ``c_k = charged_k (1 - Phi(score_k(q_k)))``. For a robot with dynamics, state
x_k = (q_k, r_k), resting position s(x_k) and turning time turning(x_k, pivot), it is::

    effort sum |q_k - q_{k-1}|^2
        + sum c_k (rate |s(x_k) - pivot| + braking |s(x_k) - q_k| + turning(x_k, pivot))

If the pivot is reachable within the horizon, every step pays for the remaining distance; otherwise
arriving late would be free. The resting position makes the robot brake as late as possible, and
the outage price applies up to it; otherwise expensive parts would be postponed again and again.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planopt.arrays import Derivatives, Floats
from planopt.planning.programme.solver import MotionShape
from planopt.robots.dynamics import Components


def margins_of(
    mean: Derivatives, deviation: Derivatives, threshold_dbm: float, z: float | Floats
) -> Derivatives:
    """Return ``mean - threshold - z deviation`` of all stages in dB; z is a scalar or ``(N,)``."""
    rows = mean.rows - np.reshape(z, (-1, 1)) * deviation.rows
    rows[:, 0] -= threshold_dbm
    return Derivatives.of(rows)


@dataclass(frozen=True)
class PathValue:
    """Scalar function of a path of N steps, with first and second derivatives."""

    value: float
    gradient: Floats  # (N, 2)
    # (N, 3), xx, xy and yy of each stage, if stagewise. (7 N - 4,) for a chain: these, then xx, xy,
    # yx and yy between each stage and the next. Else (2 N, 2 N).
    hessian: Floats


@dataclass(frozen=True)
class Evaluation:
    """Objective value of one path, and the margins or the sum to which constraints apply."""

    value: PathValue | None  # None if CasADi differentiates the cost of reaching a goal
    margins: Derivatives | None  # Margins of the N stages
    total: PathValue | None = None  # Sum over stages with Hessian (N, 3)
    scores: Derivatives | None = None  # Normal scores of connection, if outage is priced

    @property
    def rows(self) -> Floats:
        """Return the values to which constraints apply: N margins, or one sum."""
        if self.margins is not None:
            return self.margins.value
        if self.total is None:
            raise AssertionError("no row is bounded")
        return np.array([self.total.value])


EvaluatePath = Callable[[Floats], Evaluation]
"""Function that maps positions (N, 2) to their evaluation."""


def remembering(evaluate: EvaluatePath) -> EvaluatePath:
    """Return `evaluate` with a cache for the last path."""
    # Solvers request value, rows and derivatives at the same point in separate calls.
    key, last = b"", None

    def remembered(places_m: Floats) -> Evaluation:
        nonlocal key, last
        requested = places_m.tobytes()
        if last is None or requested != key:
            key, last = requested, evaluate(places_m)
        return last

    return remembered


@dataclass
class ValueSource:
    """Evaluation function for a solver's callbacks, which every solve sets anew."""

    evaluate: EvaluatePath | None = None  # Remembers its last path

    def __call__(self, flat: Floats) -> Evaluation:
        """Return the evaluation at positions flattened to (2 N,)."""
        if self.evaluate is None:
            raise AssertionError("a solver was called before its value was set")
        return self.evaluate(flat.reshape(-1, 2))


PIVOT_ROUNDING_M, STEP_ROUNDING_M = 1e-2, 1e-2
"""Smoothing widths of the distance to the pivot and of step lengths, which have cusps at zero."""


@dataclass(frozen=True, eq=False)
class PricedCharge:
    """Parameters of the cost of reaching a goal, for a single integrator."""

    pivot_m: Floats  # (2,) terminal waypoint of the cost-to-go
    effort_s_m2: float  # Cost per squared step length, and per metre beyond the horizon
    rate_s_m: float
    price_s_m: float  # Cost of a metre out of contact
    share_before: float  # Penalised fraction of a metre at the start
    charged: Floats  # (N,) penalised fraction after each step if it is certainly out of contact

    @property
    def numbers(self) -> Floats:
        """Return the parameters as an array (6 + N,) for :func:`priced_cost_s`."""
        costs = (self.effort_s_m2, self.rate_s_m, self.price_s_m, self.share_before)
        return np.array([*self.pivot_m, *costs, *self.charged])


def priced_cost_s(n: int, q: Any, scores: Any, start: Any, charge: Any) -> Any:
    """Return the symbolic goal cost in seconds of positions `q` (2 N,) and scores (N,)."""
    effort, rate, price, share = (charge[i] for i in range(2, 6))
    before, cost = start, 0.0
    for k in range(n):
        here = q[2 * k : 2 * k + 2]
        step = here - before
        square = step[0] ** 2 + step[1] ** 2
        next_share = charge[6 + k] * 0.5 * (1.0 - ca.erf(scores[k] / math.sqrt(2.0)))
        length = ca.sqrt(square + STEP_ROUNDING_M**2)
        cost += effort * square + 0.5 * price * length * (share + next_share)
        before, share = here, next_share
    away = before - charge[0:2]
    return cost + rate * ca.sqrt(away[0] ** 2 + away[1] ** 2 + PIVOT_ROUNDING_M**2)


ROUNDING_STEPS = 0.01
"""Smoothing width of the distance to the pivot for robots with dynamics, in longest steps."""
PARAMETERS = 7  # Number of parameters of `GoalCharge`


@dataclass(frozen=True)
class GoalCharge:
    """Parameters of the cost of reaching a goal, for a robot with dynamics."""

    pivot_m: Floats  # (2,)
    # Cost per squared step length, per metre beyond the horizon, and per metre of the braking
    # distance
    effort_s_m2: float
    rate_s_m: float
    braking_s_m: float
    each_step: float  # Constant added to every c_k; 0 if the pivot is not reachable
    rounding_m: float  # Smoothing width of the distance to the pivot

    @property
    def numbers(self) -> Floats:
        """Return the parameters as an array (7,) for :func:`goal_cost_s`."""
        costs = (self.effort_s_m2, self.rate_s_m, self.braking_s_m)
        return np.array([*self.pivot_m, *costs, self.each_step, self.rounding_m])


LocalModel = tuple[EvaluatePath, GoalCharge | PricedCharge | None]
"""Evaluation of paths near a guess, and the cost of reaching a goal, if there is one."""


def goal_cost_s(shape: MotionShape, q: Any, w: Any, start: Components, charge: Any) -> Any:
    """Return the symbolic goal cost in seconds of positions `q` and motion variables `w`."""
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
