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

import numpy as np
from scipy.special import ndtr

from planopt.arrays import Derivatives, Floats, add_products
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

    value: PathValue
    margins: Derivatives | None  # Margins of the N stages
    total: PathValue | None = None  # Sum over stages with Hessian (N, 3)

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


class ValueSource:
    """Evaluation function for a solver's callbacks; every solve sets a new function."""

    def __init__(self) -> None:
        self._evaluate: EvaluatePath | None = None

    def use(self, evaluate: EvaluatePath) -> None:
        """Set the evaluation function, with an empty cache."""
        self._evaluate = remembering(evaluate)

    def __call__(self, flat: Floats) -> Evaluation:
        """Return the evaluation at positions flattened to (2 N,)."""
        if self._evaluate is None:
            raise AssertionError("a solver was called before its value was set")
        return self._evaluate(flat.reshape(-1, 2))


PIVOT_ROUNDING_M, STEP_ROUNDING_M = 1e-2, 1e-2
"""Smoothing widths of the distance to the pivot and of step lengths, which have cusps at zero."""


DENSITY = 1.0 / math.sqrt(2.0 * math.pi)
"""Standard normal density at zero."""


@dataclass(frozen=True)
class OutagePrice:
    """Price per metre out of contact, and fractions of the steps to which it applies."""

    price_s_m: float  # Cost of a metre out of contact
    share_before: float  # Penalised fraction of a metre at the start
    charged: Floats  # (N,) penalised fraction after each step if it is certainly out of contact


@dataclass(frozen=True, eq=False)
class GoalValue:
    """Objective of a single integrator's path to a goal, with connectivity margins."""

    start_m: Floats  # (2,) position of the robot
    pivot_m: Floats  # (2,) terminal waypoint of the cost-to-go
    effort_s_m2: float  # Cost per squared step length, and per metre beyond the horizon
    rate_s_m: float
    outage: OutagePrice
    # Maps positions to each stage's connectivity margin and its normal score of connection
    margins: Callable[[Floats], tuple[Derivatives, Derivatives]]

    def __call__(self, places_m: Floats) -> Evaluation:
        """Return the objective value and connectivity margins of a path (N, 2)."""
        margins, scores = self.margins(places_m)
        return Evaluation(self._value(places_m, scores), margins)

    def _value(self, places_m: Floats, score: Derivatives) -> PathValue:
        outage, half, effort = self.outage, 0.5 * self.outage.price_s_m, 2.0 * self.effort_s_m2
        steps = places_m.copy()
        steps[0] -= self.start_m
        steps[1:] -= places_m[:-1]
        step_squares = _square(steps)
        squares = step_squares[:, 0] + step_squares[:, 2]
        lengths = np.sqrt(squares + STEP_ROUNDING_M**2)
        # Penalised fraction of a metre after each step, with derivatives by score and position.
        z = score.value
        share = outage.charged * ndtr(-z)
        by_score = outage.charged * np.exp(-0.5 * z * z) * -DENSITY
        share_slope = by_score[:, None] * score.gradient
        by_length, by_share = half * share, half * lengths
        by_length[0] += half * outage.share_before
        by_length[1:] += half * share[:-1]
        by_share[:-1] += half * lengths[1:]
        to_pivot = places_m[-1] - self.pivot_m
        away = math.sqrt(float(to_pivot @ to_pivot) + PIVOT_ROUNDING_M**2)
        cost = 0.5 * effort * squares.sum() + self.rate_s_m * away + by_length @ lengths

        bend = by_length / lengths
        pull = effort + bend
        by_step = pull[:, None] * steps
        gradient = by_share[:, None] * share_slope
        gradient += by_step
        gradient[:-1] -= by_step[1:]
        gradient[-1] += self.rate_s_m / away * to_pivot

        # Blocks of each stage, and blocks that couple each stage with the next.
        n = len(steps)
        entries = np.empty(7 * n - 4)
        own, across = entries[: 3 * n].reshape(n, 3), entries[3 * n :].reshape(n - 1, 2, 2)
        step_bend = step_squares
        step_bend *= (-bend / (lengths * lengths))[:, None]
        step_bend[:, ::2] += pull[:, None]
        np.multiply(_square(score.gradient), -z[:, None], out=own)
        own += score.hessian
        own *= (by_share * by_score)[:, None]
        own += step_bend
        own[:-1] += step_bend[1:]
        turn = steps * (half / lengths)[:, None]
        on = turn[1:].copy()
        turn[:-1] -= on
        add_products(own, turn, share_slope)
        own[-1, ::2] += self.rate_s_m / away
        own[-1] -= self.rate_s_m / away**3 * _square(to_pivot)
        np.multiply(share_slope[:-1, :, None], on[:, None], out=across)
        across -= on[:, :, None] * share_slope[1:, None]
        across -= step_bend[1:].take(FULL, axis=1)
        return PathValue(-float(cost), np.negative(gradient, out=gradient), -entries)


FULL = np.array([[0, 1], [1, 2]])
"""Indices of a symmetric 2 x 2 matrix in its entries xx, xy, yy."""
LEFT, RIGHT = np.array([0, 0, 1]), np.array([0, 1, 1])
"""Components of a vector whose products are the entries xx, xy, yy of its outer product."""


def _square(a: Floats) -> Floats:
    """Return the entries xx, xy, yy of the outer products a a' of vectors a (..., 2)."""
    return a.take(LEFT, axis=-1) * a.take(RIGHT, axis=-1)


ROUNDING_STEPS = 0.01
"""Smoothing width of the distance to the pivot for robots with dynamics, in longest steps."""
PARAMETERS = 7
"""Number of parameters of `GoalCharge`."""


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
