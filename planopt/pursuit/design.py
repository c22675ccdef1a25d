"""Co-design of pursuit and network: slot width, rate and compression of minimum power or energy.

The cheapest design has the slowest rounds and coarsest reports that the guarantee of capture allows
(equations 8.11 to 8.14). For a fixed number of bits c, all limits on the slot are linear and the
optimum has a closed form; all c are tried. With continuous compression the problem is a convex
programme, whose optimum is a lower bound.
"""

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from pydantic import Field

from planopt.errors import InputError, NoPlanError
from planopt.keys import SMALLEST, Length, Table
from planopt.pursuit.certificate import Inequality, Theorem
from planopt.pursuit.guarantees import Chase, Guarantee, capture_guarantees, contraction
from planopt.pursuit.service import (
    HOPS_PER_ROUND,
    MAX_LEVELS,
    SLOTS_PER_FRAME,
    SnapshotService,
    peak_blocks_per_frame,
    relative_error,
)

MAX_SLOT_BLOCKS = 10_000  # Maximum number of blocks in a slot
ROUNDING = 1e-9  # Relative rounding tolerance of a slot that carries its blocks exactly
MAX_BITS = 16  # Maximum number of bits per axis; errors are then 0.001 % of the distance
SLOT_SHARE = 1e-10  # Relative tolerance of the bisection for the widest slot

PAYLOAD_FITS = "slot of the payload below the longest admissible slot"
IN_TIME = "time to capture below the deadline"

SHARP_ORDER = {"capture_radius": 1, "deadline": 2, "payload": 3}
"""Order in which requirements are checked; a later failure is closer to a feasible design."""
ELASTICITY_STEP = 1e-5  # Relative step of the finite differences for sensitivities
TOLERANCE = 1e-10  # Tolerance of the solver; scaled costs agree with closed forms to 1e-6


class NoDesignError(NoPlanError):
    """Error raised if no network meets the requirements."""

    def __init__(self, inequality: Inequality, bits_per_axis: int, held: int) -> None:
        self.inequality, self.bits_per_axis = inequality, bits_per_axis
        # A failure after more inequalities that hold is closer to a feasible design.
        self.order = held, inequality.margin / inequality.right
        super().__init__(
            "no design meets the requirements; with "
            f"{bits_per_axis} bit{'' if bits_per_axis == 1 else 's'} per coordinate, {inequality}"
        )


def mean_blocks_per_frame(border_relays: bool, levels: int, sparse: bool = False) -> float:
    """Return the mean number of blocks per frame flooded by a mote far from the edges."""
    # A level-j round of ``3 * 2^j`` frames has nine blocks per mote, or ``(3 - 2^(1 - j))^2``
    # without border relays. All levels together need ``3 (2 - 2^-L) < 6`` blocks, or less than 2.2.
    cell = np.exp2(np.arange(levels + 1))
    each = np.full(levels + 1, 9.0) if border_relays else (3.0 - 2.0 / cell) ** 2
    if sparse:
        # The cell that the evader leaves and the cell that it enters, of ``4^(L - j)``.
        each *= np.minimum(1.0, 2.0 * (cell / cell[-1]) ** 2)
    return float((each / (HOPS_PER_ROUND * cell)).sum())


class MoteNetwork(Table):
    """Table ``[network]``: motes and their radios; costs assume motes far from the edges."""

    levels: int = Field(ge=1, le=MAX_LEVELS)
    """Number of levels L; there are 4^L motes."""
    mote_spacing_m: Length
    """Distance between neighbouring motes, in metres."""
    bit_rate_bit_s: float = Field(ge=SMALLEST, le=1e15)
    """Bit rate within a slot, in bit/s."""
    header_bits: float = Field(ge=0, le=1e9)
    """Bits of a frame header, in addition to the blocks."""
    record_bits: float = Field(ge=0, le=1e9)
    """Bits of a block, in addition to the position."""
    energy_j_per_bit: float = Field(ge=1e-15, le=1e6)
    """Energy per transmitted bit, including reception, in J."""
    idle_w: float = Field(default=0.0, ge=0, le=1e6)
    """Constant power of a mote, in W."""
    slots_per_frame: int = Field(default=SLOTS_PER_FRAME, ge=SLOTS_PER_FRAME, le=10_000)
    """Number of slots per TDMA frame."""
    slot_blocks: int | None = Field(default=None, ge=1, le=MAX_SLOT_BLOCKS)
    """Minimum capacity of a slot in blocks; default: the peak load, so that no record is late.
    """
    updates: Literal["full", "sparse"] = "full"
    """Reports that a round sends: full (of all cells) or sparse (changes alone, of one evader whose
    reports change in every round)."""
    border_relays: bool = True
    """Flag for relaying of records by motes at the border of the nine cells."""

    @property
    def motes(self) -> int:
        """Return the number of motes."""
        return 4**self.levels

    @property
    def mean_blocks(self) -> float:
        """Return the mean number of blocks that a mote sends per frame."""
        return mean_blocks_per_frame(self.border_relays, self.levels, self.updates == "sparse")

    @property
    def least_slot_blocks(self) -> int:
        """Return the required capacity of a slot in blocks."""
        sparse = self.updates == "sparse"
        peak = peak_blocks_per_frame(self.border_relays, self.levels, sparse)
        return self.slot_blocks or peak

    def slot_capacity(self, slot_width_s: float, bits_per_axis: int) -> int:
        """Return the number of blocks that fit into a slot in addition to the header."""
        block_bits = self.record_bits + 2.0 * bits_per_axis
        free_bits = self.bit_rate_bit_s * slot_width_s * (1.0 + ROUNDING) - self.header_bits
        return min(int(free_bits / max(block_bits, 1.0)), MAX_SLOT_BLOCKS)

    def frame_bits(self, bits_per_axis: float) -> float:
        """Return the mean number of bits that a mote sends per frame, header included."""
        return self.header_bits + self.mean_blocks * (self.record_bits + 2.0 * bits_per_axis)

    def least_slot_s(self, bits_per_axis: float) -> float:
        """Return the width of a slot that carries the header and the required number of blocks."""
        block_bits = self.record_bits + 2.0 * bits_per_axis
        return (self.header_bits + self.least_slot_blocks * block_bits) / self.bit_rate_bit_s

    def power_w(
        self, slot_width_s: float, bits_per_axis: float, rate_divisor: float = 1.0
    ) -> float:
        """Return the network's power in W; motes sleep except in every `rate_divisor`-th round."""
        lasts_s = self.slots_per_frame * slot_width_s * rate_divisor
        sent_w = self.energy_j_per_bit * self.frame_bits(bits_per_axis) / lasts_s
        return self.motes * (sent_w + self.idle_w)

    def service(
        self, slot_width_s: float, bits_per_axis: int, rate_divisor: int = 1
    ) -> SnapshotService:
        """Return the snapshot service of the network."""
        return SnapshotService(
            self.levels,
            self.mote_spacing_m,
            self.slots_per_frame * slot_width_s,
            bits_per_axis,
            rate_divisor=rate_divisor,
        )


@dataclass(frozen=True)
class DesignTask:
    """Requirements on a network design."""

    network: MoteNetwork
    chase: Chase
    margin: float = 0.01  # delta: minimum of 1 - contraction - staleness
    bits_per_axis: int | None = None  # c; None to optimise it
    first_distance_m: float | None = None  # From the pursuer to the evader's first sample
    capture_radius_m: float | None = None  # None without this requirement
    deadline_s: float | None = None  # None without this requirement

    @property
    def bits(self) -> Iterable[int]:
        """Return the candidate numbers of bits per axis."""
        return range(1, MAX_BITS + 1) if self.bits_per_axis is None else (self.bits_per_axis,)

    @property
    def staleness_per_slot(self) -> float:
        """Return the staleness per second of slot width (1/s), for rate divisor 1."""
        frames = 4.0 * HOPS_PER_ROUND * self.network.slots_per_frame
        return frames * self.chase.evader_speed_m_s / self.network.mote_spacing_m

    def room(self, bits_per_axis: float) -> float:
        """Return the upper limit of the staleness, given contraction and margin."""
        kappa = relative_error(bits_per_axis)
        return 1.0 - contraction(self.chase.speed_ratio, kappa) - self.margin


@dataclass(frozen=True, eq=False)
class Design:
    """Network design for a pursuit."""

    task: DesignTask
    slot_width_s: float  # s_w
    rate_divisor: int  # r
    bits_per_axis: int  # c
    cost_w: float  # Power of the network
    # Active requirements, which prevent a lower cost: lemma, payload, deadline, capture_radius, or
    # the name of a theorem
    binding: tuple[str, ...]
    guarantees: dict[Theorem, Guarantee]

    @property
    def capture_time_s(self) -> float:
        """Return the maximum capture time by Lemma III.3; infinite if the lemma fails."""
        x = 0.5 * (1 + self.rate_divisor) * self.slot_width_s * self.task.staleness_per_slot
        left = _left(self.task, self.bits_per_axis) - x
        return _driving_s(self.task, self.bits_per_axis) / left if left > 0.0 else math.inf

    @property
    def energy_per_capture_j(self) -> float:
        """Return the energy that the network consumes within the maximum capture time."""
        return self.cost_w * self.capture_time_s


def cheapest_design(task: DesignTask) -> Design:
    """Return the minimum-power design that satisfies Lemma III.3 with the required margin."""
    # For each c the widest slot is ``(1 - a - delta) / (12 eta_s v_e)``, and power decreases with
    # the slot width.
    return _scan(task, lambda bits: (_widest_s(task, bits), 1, ("lemma",)))


def cheapest_rated_design(task: DesignTask) -> Design:
    """Return the minimum-power design by Lemma III.3, with the rate divisor optimised as well."""
    # Ages are then at most ``6 (1 + r) eta_s s_w`` frames per spacing. Short slots with infrequent
    # rounds cost down to half as much as long slots, provided that motes sleep in between. The
    # largest divisor for which slots carry the payload is the cheapest.

    def candidate(bits: int) -> _Found:
        widest_s = _widest_s(task, bits)
        divisor = math.floor(2.0 * widest_s / task.network.least_slot_s(bits) - 1.0)
        return 2.0 * widest_s / (1 + divisor), divisor, ("lemma", "payload")

    return _scan(task, candidate)


def least_energy_design(task: DesignTask) -> Design:
    """Return the design of minimum energy per capture, with the capture time by Lemma III.3."""
    # Energy is power times ``(1 + kappa) d / (alpha v_e (1 - a - x))``. For each c the minimum is
    # at half of the Lemma's slot width, if payload and deadline (if any) permit.
    return _scan(task, partial(_energy_candidate, task), lambda design: design.energy_per_capture_j)


def sharp_design(task: DesignTask, theorem: Theorem = Theorem.SAMPLED_DISTANCE) -> Design:
    """Return the minimum-power design that guarantees capture by the deadline under a theorem."""
    # All bounds, including floors, increase with the slot width, so bisection finds the widest
    # slot.
    return _scan(task, partial(_sharp_candidate, task, theorem))


def pareto_front(task: DesignTask, deadlines_s: Iterable[float]) -> list[Design]:
    """Return the design of minimum energy per capture for each deadline."""
    # Energy and time follow from the Lemma. Infeasible deadlines and dominated designs are omitted.
    found: list[Design] = []
    for deadline_s in sorted(deadlines_s):
        try:
            design = least_energy_design(replace(task, deadline_s=deadline_s))
        except NoDesignError:
            continue
        if not found or design.energy_per_capture_j < found[-1].energy_per_capture_j:
            found.append(design)
    return found


def sensitivities(
    task: DesignTask,
    solve: Callable[[DesignTask], Design],
    objective: Callable[[Design], float] = lambda design: design.cost_w,
) -> dict[str, float]:
    """Return elasticities: percentage change of the optimum per 1 % increase of each quantity."""
    # The number of bits is fixed at its optimum.
    fixed = replace(task, bits_per_axis=solve(task).bits_per_axis)

    def log_optimum(name: str, factor: float) -> float:
        chase, network = fixed.chase, fixed.network
        if hasattr(chase, name):
            chase = replace(chase, **{name: factor * getattr(chase, name)})
        else:
            network = network.model_copy(update={name: factor * getattr(network, name)})
        return math.log(objective(solve(replace(fixed, chase=chase, network=network))))

    speeds = ("evader_speed_m_s", "pursuer_speed_m_s")
    return {
        name: (log_optimum(name, 1.0 + ELASTICITY_STEP) - log_optimum(name, 1.0 - ELASTICITY_STEP))
        / (2.0 * ELASTICITY_STEP)
        for name in (*speeds, "bit_rate_bit_s", "header_bits", "record_bits", "mote_spacing_m")
    }


_Found = tuple[float, int, tuple[str, ...]]
"""Slot width and rate divisor of a design, with its active requirements."""


def _scan(
    task: DesignTask,
    candidate: Callable[[int], _Found],
    objective: Callable[[Design], float] = lambda design: design.cost_w,
) -> Design:
    """Return the best design over all numbers of bits; if all fail, raise the closest failure."""
    designs: list[Design] = []
    failures: list[NoDesignError] = []
    for c in task.bits:
        try:
            slot_s, divisor, binding = candidate(c)
        except NoDesignError as error:
            failures.append(error)
            continue
        bounds = task.network.service(slot_s, c, divisor).bounds
        power_w = task.network.power_w(slot_s, c, divisor)
        each = capture_guarantees(task.chase, bounds)
        designs.append(Design(task, slot_s, divisor, c, power_w, binding, each))
    if designs:
        return min(designs, key=objective)
    raise max(failures, key=lambda failure: failure.order)


def _energy_candidate(task: DesignTask, bits: int) -> _Found:
    """Return the feasible slot width of minimum energy per capture for a number of bits."""
    # A and B are the costs of transmission and idling, q = 1 - a and p s = x.
    widest_s = _widest_s(task, bits)
    network, per_slot = task.network, task.staleness_per_slot
    left, least_s = _left(task, bits), network.least_slot_s(bits)
    sent = network.energy_j_per_bit * network.frame_bits(bits) / network.slots_per_frame
    idle = network.idle_w * left / (sent * per_slot)
    limits = {"": left / (per_slot * (1.0 + math.sqrt(1.0 + idle))), "lemma": widest_s}
    if task.deadline_s is not None:
        driving_s = _driving_s(task, bits)
        limits["deadline"] = (left - driving_s / task.deadline_s) / per_slot
        soonest_s = driving_s / (left - least_s * per_slot)
        in_time = Inequality(IN_TIME, soonest_s, task.deadline_s, "s")
        if not in_time.holds:
            raise NoDesignError(in_time, bits, 2)
    binding = min(limits, key=lambda name: limits[name])
    if limits[binding] < least_s:
        return least_s, 1, ("payload",)
    return limits[binding], 1, (binding,) if binding else ()


def _sharp_candidate(task: DesignTask, theorem: Theorem, bits: int) -> _Found:
    """Return the widest slot that satisfies a theorem, the capture radius and the deadline."""
    least_s = task.network.least_slot_s(bits)
    failing = partial(_failing, task, theorem, bits)
    fails, narrow_s = failing(least_s), SLOT_SHARE * least_s
    if fails is not None:
        if failing(narrow_s) is not None:
            raise NoDesignError(fails[1], bits, SHARP_ORDER.get(fails[0], 0))
        # Narrower slots satisfy the requirements, but they cannot carry the payload.
        widest_s, _ = _bisected(failing, narrow_s, least_s)
        fits = Inequality(PAYLOAD_FITS, least_s, widest_s, "s")
        raise NoDesignError(fits, bits, SHARP_ORDER["payload"])
    low, high = least_s, 2.0 * least_s
    while failing(high) is None:
        low, high = high, 2.0 * high
    low, high = _bisected(failing, low, high)
    fails = failing(high)
    assert fails is not None
    return low, 1, (fails[0],)


def _bisected(
    failing: Callable[[float], tuple[str, Inequality] | None], low: float, high: float
) -> tuple[float, float]:
    """Return the widest slot that meets all requirements, and a slot that is just too wide."""
    while high - low > SLOT_SHARE * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if failing(middle) is None else (low, middle)
    return low, high


def _failing(
    task: DesignTask, theorem: Theorem, bits: int, slot_s: float
) -> tuple[str, Inequality] | None:
    """Return the name and inequality of the first requirement that a slot violates."""
    assert task.capture_radius_m is not None and task.deadline_s is not None
    found = capture_guarantees(task.chase, task.network.service(slot_s, bits).bounds)[theorem]
    for each in found.inequalities:
        if not each.holds:
            return theorem.value, each
    caught = found.captures(task.capture_radius_m)
    if not caught.holds:
        return "capture_radius", caught
    lasts_s = found.capture_time_s(_first_distance_m(task), task.capture_radius_m)
    in_time = Inequality(IN_TIME, lasts_s, task.deadline_s, "s")
    return None if in_time.holds else ("deadline", in_time)


def _widest_s(task: DesignTask, bits: int) -> float:
    """Return the widest slot by Lemma III.3; raise an error with the violated inequality."""
    room = task.room(bits)
    shrinks = Inequality("a + margin below 1", 1.0 - room, 1.0)
    if not shrinks.holds:
        raise NoDesignError(shrinks, bits, 0)
    widest_s = room / task.staleness_per_slot
    fits = Inequality(PAYLOAD_FITS, task.network.least_slot_s(bits), widest_s, "s")
    if not fits.holds:
        raise NoDesignError(fits, bits, 1)
    return widest_s


def _left(task: DesignTask, bits: int) -> float:
    """Return one minus the contraction factor per stage."""
    return task.room(bits) + task.margin


def _driving_s(task: DesignTask, bits: int) -> float:
    """Return the maximum duration of the first stage."""
    first_m = (1.0 + relative_error(bits)) * _first_distance_m(task)
    return first_m / task.chase.pursuer_speed_m_s


def _first_distance_m(task: DesignTask) -> float:
    if task.first_distance_m is None:
        raise InputError(
            "is missing: without it the capture time is not bounded", key="first_distance_m"
        )
    return task.first_distance_m


@dataclass(frozen=True)
class RelaxedDesign:
    """Optimum with continuous compression and rate, a lower bound of the power."""

    cost_w: float  # Lower bound on the cost of designs with integer c and r
    slot_width_s: float  # s_w
    rate_divisor: float  # r
    relative_error: float  # kappa


def relaxed_design(
    task: DesignTask, *, rated: bool = False, bits_per_axis: float | None = None
) -> RelaxedDesign:
    """Return the slot width and compression of minimum power under Lemma III.3."""
    import cvxpy as cp

    network, chase = task.network, task.chase
    u = 1.0 / chase.speed_ratio
    # Slots are scaled by the widest one, which belongs to exact reports.
    unit_s = (1.0 - u - task.margin) / task.staleness_per_slot
    bits = network.header_bits + network.mean_blocks * network.record_bits
    t, z, w = cp.Variable(pos=True), cp.Variable(pos=True), cp.Variable(pos=True)
    block = (network.record_bits + 1.0) * t + 2.0 / math.log(2.0) * cp.rel_entr(t, z)
    limits: list[Any] = [
        0.5 * (w + 1.0) + (1.0 + u) / (1.0 - u - task.margin) * z <= t,
        network.header_bits * t + network.least_slot_blocks * block
        <= network.bit_rate_bit_s * unit_s * w,
        z <= t,
        w <= 1.0 if rated else w == 1.0,
    ]
    if bits_per_axis is not None:
        limits.append(z == relative_error(bits_per_axis) * t)
    sent = (network.header_bits * t + network.mean_blocks * block) / bits
    problem: Any = cp.Problem(cp.Minimize(sent), limits)
    tolerances = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), TOLERANCE)
    try:
        with warnings.catch_warnings():
            # CVXPY warns of an inaccurate optimum that is in fact accurate to eight digits.
            warnings.simplefilter("ignore")
            problem.solve(solver=cp.CLARABEL, **tolerances)
    except cp.SolverError:
        raise NoPlanError("the programme of the network's design was not solved") from None
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise NoPlanError(f"the programme of the network's design is {problem.status}")
    solved: list[Any] = [t, z, w]
    scale, error, width = (float(each.value) for each in solved)
    y_s, slot_s = unit_s / scale, width * unit_s / scale
    rate = network.motes * network.energy_j_per_bit / network.slots_per_frame
    cost_w = rate * bits * float(problem.value) / unit_s + network.motes * network.idle_w
    return RelaxedDesign(cost_w, slot_s, y_s / slot_s, error / scale)
