"""The co-design problems as convex programmes, with compression as a continuous variable.

Power over a slot, ``g(kappa) / s_w``, is quasiconvex. With ``t = 1 / y`` (y the slot width times r)
and ``z = kappa t`` it becomes ``t g(z / t)``, the perspective of a convex function, and all limits
stay convex (Charnes and Cooper): relative entropies, which Clarabel solves at once, where bisection
over levels would stop at its first badly scaled level. All quantities are scaled to about one.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

from planopt.errors import InputError, NoPlanError
from planopt.pursuit.design import DesignTask
from planopt.pursuit.guarantees import contraction
from planopt.pursuit.service import relative_error

TOLERANCE = 1e-10
"""Of the solver; scaled, costs agree with closed forms to 1e-6."""


@dataclass(frozen=True)
class RelaxedDesign:
    """An optimum over continuous compression and rate."""

    cost_w: float  # Its power: at most that of any design with whole numbers
    slot_width_s: float  # s_w, r and kappa
    rate_divisor: float
    relative_error: float


def relaxed_design(
    task: DesignTask, *, rated: bool = False, bits_per_axis: float | None = None
) -> RelaxedDesign:
    """Solve for slot width and compression of least power under the Lemma."""
    import cvxpy as cp

    network, chase = task.network, task.chase
    u = 1.0 / chase.speed_ratio
    # Slots are counted in widest ones: where nothing but age uses up the room.
    unit_s = (1.0 - u - task.margin) / task.staleness_per_slot
    bits = network.header_bits + network.mean_blocks * network.record_bits
    t, z, w = cp.Variable(pos=True), cp.Variable(pos=True), cp.Variable(pos=True)
    block = (network.record_bits + 1.0) * t + 2.0 / math.log(2.0) * cp.rel_entr(t, z)
    age = 0.5 * (w + 1.0)
    limits = [
        age + (1.0 + u) / (1.0 - u - task.margin) * z <= t,
        network.header_bits * t + network.slot_blocks * block
        <= network.bit_rate_bit_s * unit_s * w,
        z <= t,
        w <= 1.0 if rated else w == 1.0,
    ]
    if bits_per_axis is not None:
        limits.append(z == relative_error(bits_per_axis) * t)
    sent = (network.header_bits * t + network.mean_blocks * block) / bits
    value = _solve(cp.Minimize(sent), limits)
    y_s = unit_s / _number(t)
    slot_s = _number(w) * y_s
    rate = network.motes * network.energy_j_per_bit / network.slots_per_frame
    return RelaxedDesign(
        rate * bits * value / unit_s + network.motes * network.idle_w,
        slot_s,
        y_s / slot_s,
        _number(z) / _number(t),
    )


def least_energy_slot_s(task: DesignTask, bits_per_axis: int) -> float:
    """Solve for the slot width of least energy per capture at so many bits, by the Lemma's bound.

    Energy is a constant times ``A / (s (q - p s)) + B / (q - p s)``, which is convex.
    """
    import cvxpy as cp

    network = task.network
    unit_s = 1.0 / task.staleness_per_slot
    sent = network.energy_j_per_bit * network.frame_bits(bits_per_axis) / network.slots_per_frame
    x = cp.Variable(pos=True)
    left = task.room(bits_per_axis) + task.margin - x
    idle = network.idle_w * unit_s / sent
    energy = (_reciprocal(x, left) + idle * _reciprocal(left)) / (1.0 + idle)
    limits = [
        x <= task.room(bits_per_axis),
        network.least_slot_s(bits_per_axis) <= unit_s * x,
    ]
    _solve(cp.Minimize(energy), limits)
    return unit_s * _number(x)


def sharp_slot_s(task: DesignTask, bits_per_axis: int) -> float:
    """Solve for the widest slot at so many bits that the trail's theorem allows, floors left out.

    The capture radius must be above the floor, and the bound of the time to capture below the
    deadline; at a fixed number of bits both are linear in the slot.
    """
    import cvxpy as cp

    first_m, radius_m, deadline_s = (
        task.first_distance_m,
        task.capture_radius_m,
        task.deadline_s,
    )
    if first_m is None or radius_m is None or deadline_s is None:
        raise InputError("a sharp design needs first distance, capture radius and deadline")
    alpha, speed = task.chase.speed_ratio, task.chase.evader_speed_m_s
    kappa = relative_error(bits_per_axis)
    unit_s = 1.0 / task.staleness_per_slot
    bounds = task.network.service(unit_s, bits_per_axis).bounds
    error_m = bounds.error_floor_m * (alpha + 1.0) / (alpha - 1.0)
    x = cp.Variable(pos=True)
    longest_s = (1.0 + kappa) * (1.0 + x) * first_m / (alpha * speed)
    limits = [
        longest_s <= deadline_s * (1.0 - contraction(alpha, kappa)),
        error_m * (1.0 + x) <= radius_m,
        error_m + speed * bounds.age_floor_s * x <= radius_m,
        task.network.least_slot_s(bits_per_axis) <= unit_s * x,
    ]
    _solve(cp.Maximize(x), limits)
    return unit_s * _number(x)


def _reciprocal(*factors: Any) -> Any:
    """One over a product of positive expressions."""
    import cvxpy

    cp: Any = cvxpy
    return cp.inv_prod(cp.hstack(factors))


def _solve(objective: Any, limits: list[Any]) -> float:
    import cvxpy as cp

    problem: Any = cp.Problem(objective, limits)
    try:
        with warnings.catch_warnings():
            # CVXPY warns of an inaccurate optimum; here that is still good to eight digits.
            warnings.simplefilter("ignore")
            problem.solve(
                solver=cp.CLARABEL,
                tol_gap_abs=TOLERANCE,
                tol_gap_rel=TOLERANCE,
                tol_feas=TOLERANCE,
            )
    except cp.SolverError:
        raise NoPlanError("the programme of the network's design was not solved") from None
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise NoPlanError(f"the programme of the network's design is {problem.status}")
    return float(problem.value)


def _number(variable: Any) -> float:
    return float(variable.value)
