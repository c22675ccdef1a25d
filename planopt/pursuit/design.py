"""Co-design of pursuit and network: slot width, rate and compression of least power or energy.

Rounds as slow and reports as coarse as the guarantee of capture allows cost least (equations 8.11
to 8.14). For a number c of bits all limits on the slot are linear, so that the best slot is known;
c is scanned. With compression as a continuous variable the same problem is a convex programme,
whose optimum is a lower bound.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from planopt.errors import InputError, NoPlanError
from planopt.pursuit.guarantees import Chase, Guarantee, contraction, guarantees
from planopt.pursuit.network import MoteNetwork
from planopt.pursuit.service import relative_error, require_count, require_number
from planopt.pursuit.theorems import Inequality, Theorem

MAX_BITS = 16
"""No more bits an axis are tried: errors are then a thousandth of a per cent of the distance."""

SLOT_SHARE = 1e-10
"""Share of its width to which the widest slot is found by halving."""

PAYLOAD_FITS = "slot of the payload below the widest slot"
IN_TIME = "time to capture below the deadline"

SHARP_ORDER = {"capture_radius": 1, "deadline": 2, "payload": 3}
"""What is looked at after the theorem's own inequalities."""

ELASTICITY_STEP = 1e-5
"""Share by which a quantity is changed to find what it is worth."""


class NoDesignError(NoPlanError):
    """No network meets the requirement."""

    def __init__(self, inequality: Inequality, bits_per_axis: int) -> None:
        self.inequality, self.bits_per_axis = inequality, bits_per_axis
        super().__init__(f"no network serves this pursuit: with c = {bits_per_axis}, {inequality}")


@dataclass(frozen=True)
class DesignTask:
    """A pursuit to be served."""

    network: MoteNetwork  # Motes and radios
    chase: Chase  # Speeds
    margin: float = 0.01  # delta: by how much a + x stays below 1
    bits_per_axis: int | None = None  # c; None to choose it
    first_distance_m: float | None = None  # From the pursuer to where the evader is sampled first
    # How near and by when the evader is to be caught; None for no such requirement
    capture_radius_m: float | None = None
    deadline_s: float | None = None

    def __post_init__(self) -> None:
        require_number(self.margin, "margin", least=0.0)
        if self.bits_per_axis is not None:
            require_count(self.bits_per_axis, "bits_per_axis", 1, MAX_BITS)
        for key in ("first_distance_m", "capture_radius_m", "deadline_s"):
            if getattr(self, key) is not None:
                require_number(getattr(self, key), key, above=0.0)

    @property
    def bits(self) -> Iterable[int]:
        """Numbers of bits to scan."""
        return range(1, MAX_BITS + 1) if self.bits_per_axis is None else (self.bits_per_axis,)

    @property
    def staleness_per_slot(self) -> float:
        """X / s_w at r = 1, in 1/s."""
        return self.network.staleness_per_slot(self.chase.evader_speed_m_s)

    def room(self, bits_per_axis: float) -> float:
        """Return 1 - a - delta: what is left for x."""
        kappa = relative_error(bits_per_axis)
        return 1.0 - contraction(self.chase.speed_ratio, kappa) - self.margin


@dataclass(frozen=True, eq=False)
class Design:
    """A network for a pursuit."""

    task: DesignTask
    slot_width_s: float  # s_w, r and c
    rate_divisor: int
    bits_per_axis: int
    cost_w: float  # What the network draws
    # Requirements that keep it from costing less: lemma, payload, deadline, capture_radius or a
    # theorem's name
    binding: tuple[str, ...]
    guarantees: dict[Theorem, Guarantee]  # What each theorem says of the pursuit in this network

    @property
    def capture_time_s(self) -> float:
        """Longest time to capture by the Lemma, floors left out; infinite where it fails."""
        x = 0.5 * (1 + self.rate_divisor) * self.slot_width_s * self.task.staleness_per_slot
        left = _left(self.task, self.bits_per_axis) - x
        return _driving_s(self.task, self.bits_per_axis) / left if left > 0.0 else math.inf

    @property
    def energy_per_capture_j(self) -> float:
        """Return the energy that the network spends in that time."""
        return self.cost_w * self.capture_time_s


def cheapest_design(task: DesignTask) -> Design:
    """Return the design of least power for which Lemma III.3 holds by the margin.

    For each c the widest slot is ``(1 - a - delta) / (12 eta_s v_e)``, and power falls with the
    width.
    """
    return _scan(task, partial(_lemma_candidate, task))


def cheapest_rated_design(task: DesignTask) -> Design:
    """Return the design of least power by the Lemma, rounds of all levels every r-th time.

    Ages are then at most ``6 (1 + r) eta_s s_w`` frames a spacing: short slots and slow rounds
    cost up to half as much as long slots, if motes sleep in between.
    """
    return _scan(task, partial(_rated_candidate, task))


def least_energy_design(task: DesignTask) -> Design:
    """Return the design of least energy per capture, by the Lemma's bound of the time.

    Energy is power times ``(1 + kappa) d / (alpha v_e (1 - a - x))``: for each c least at half of
    the Lemma's slot width, if the payload fits and the deadline, if there is one, is met.
    """
    _first_distance_m(task)
    return _scan(task, partial(_energy_candidate, task), lambda design: design.energy_per_capture_j)


def sharp_design(task: DesignTask, theorem: Theorem = Theorem.SAMPLED_DISTANCE) -> Design:
    """Return the design of least power that guarantees capture in time, by one theorem.

    Within the deadline the evader is in the capture radius, floors included. All bounds grow with
    the slot, so that the widest is found by halving.
    """
    for key in ("first_distance_m", "capture_radius_m", "deadline_s"):
        if getattr(task, key) is None:
            raise InputError("a sharp design needs this", key=key)
    return _scan(task, partial(_sharp_candidate, task, theorem))


def pareto_front(task: DesignTask, deadlines_s: Iterable[float]) -> list[Design]:
    """Return designs of least energy per capture for each bound of the time to capture.

    Both are the Lemma's. Deadlines that no design meets are left out, and so are designs that
    another one beats in both.
    """
    _first_distance_m(task)
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
    worth: Callable[[Design], float] = lambda design: design.cost_w,
) -> dict[str, float]:
    """Return by how many per cent the optimum changes with one per cent more of a quantity.

    The number of bits stays that of the optimum.
    """
    fixed = replace(task, bits_per_axis=solve(task).bits_per_axis)
    chase, network = fixed.chase, fixed.network
    changed: dict[str, Callable[[float], DesignTask]] = {
        "evader_speed_m_s": lambda by: replace(
            fixed, chase=replace(chase, evader_speed_m_s=by * chase.evader_speed_m_s)
        ),
        "pursuer_speed_m_s": lambda by: replace(
            fixed, chase=replace(chase, pursuer_speed_m_s=by * chase.pursuer_speed_m_s)
        ),
        "bit_rate_bit_s": lambda by: replace(
            fixed, network=replace(network, bit_rate_bit_s=by * network.bit_rate_bit_s)
        ),
        "header_bits": lambda by: replace(
            fixed, network=replace(network, header_bits=by * network.header_bits)
        ),
        "record_bits": lambda by: replace(
            fixed, network=replace(network, record_bits=by * network.record_bits)
        ),
        "mote_spacing_m": lambda by: replace(
            fixed, network=replace(network, mote_spacing_m=by * network.mote_spacing_m)
        ),
    }
    found: dict[str, float] = {}
    for name, change in changed.items():
        high, low = (worth(solve(change(1.0 + sign * ELASTICITY_STEP))) for sign in (1.0, -1.0))
        found[name] = (math.log(high) - math.log(low)) / (2.0 * ELASTICITY_STEP)
    return found


@dataclass(frozen=True)
class _Found:
    """A slot width and a rate divisor, and what keeps them from costing less."""

    slot_width_s: float
    rate_divisor: int
    binding: tuple[str, ...]


@dataclass(frozen=True)
class _Failed:
    """The inequality that fails, and how many others hold before it."""

    inequality: Inequality
    held: int

    @property
    def order(self) -> tuple[int, float]:
        """Return the order of designs: what holds first, then the share by which it fails."""
        return self.held, self.inequality.margin / self.inequality.right


Candidate = _Found | _Failed


def _scan(
    task: DesignTask,
    candidate: Callable[[int, Design | None], Candidate],
    worth: Callable[[Design], float] = lambda design: design.cost_w,
) -> Design:
    """The best of all numbers of bits; an error that names what fails by least if there is none."""
    best: Design | None = None
    nearest: tuple[_Failed, int] | None = None
    for c in task.bits:
        found = candidate(c, best)
        if isinstance(found, _Failed):
            if nearest is None or found.order > nearest[0].order:
                nearest = found, c
            continue
        service = task.network.service(found.slot_width_s, c, found.rate_divisor)
        design = Design(
            task,
            found.slot_width_s,
            found.rate_divisor,
            c,
            task.network.power_w(found.slot_width_s, c, found.rate_divisor),
            found.binding,
            guarantees(task.chase, service.bounds),
        )
        if best is None or worth(design) < worth(best):
            best = design
    if best is not None:
        return best
    if nearest is None:
        raise AssertionError("every number of bits has a design or a reason against it")
    raise NoDesignError(nearest[0].inequality, nearest[1])


def _lemma_candidate(task: DesignTask, bits: int, best: Design | None) -> Candidate:
    widest_s = _widest_s(task, bits)
    return widest_s if isinstance(widest_s, _Failed) else _Found(widest_s, 1, ("lemma",))


def _rated_candidate(task: DesignTask, bits: int, best: Design | None) -> Candidate:
    """The largest r whose slots carry the payload: r / (1 + r) times the power falls with r."""
    widest_s = _widest_s(task, bits)
    if isinstance(widest_s, _Failed):
        return widest_s
    divisor = math.floor(2.0 * widest_s / task.network.least_slot_s(bits) - 1.0)
    return _Found(2.0 * widest_s / (1 + divisor), divisor, ("lemma", "payload"))


def _energy_candidate(task: DesignTask, bits: int, best: Design | None) -> Candidate:
    """The slot of least ``(A / s + B) / (q - p s)``, within the margin, the payload, a deadline.

    A and B are what sending and idling cost, q = 1 - a and p s = x.
    """
    widest_s = _widest_s(task, bits)
    if isinstance(widest_s, _Failed):
        return widest_s
    network, per_slot = task.network, task.staleness_per_slot
    left, least_s = _left(task, bits), network.least_slot_s(bits)
    sent = network.energy_j_per_bit * network.frame_bits(bits) / network.slots_per_frame
    idle = network.idle_w * left / (sent * per_slot)
    limits = {"": left / (per_slot * (1.0 + math.sqrt(1.0 + idle))), "lemma": widest_s}
    if task.deadline_s is not None:
        limits["deadline"] = (left - _driving_s(task, bits) / task.deadline_s) / per_slot
        x = least_s * per_slot
        soonest_s = _driving_s(task, bits) / (left - x)
        in_time = Inequality(IN_TIME, soonest_s, task.deadline_s, "s")
        if not in_time.holds:
            return _Failed(in_time, 2)
    binding = min(limits, key=lambda name: limits[name])
    if limits[binding] < least_s:
        return _Found(least_s, 1, ("payload",))
    return _Found(limits[binding], 1, (binding,) if binding else ())


def _sharp_candidate(
    task: DesignTask, theorem: Theorem, bits: int, best: Design | None
) -> Candidate:
    low = least_s = task.network.least_slot_s(bits)
    if best is not None:
        # Power falls with the slot: it must be wider than this to be less than the best so far.
        low = max(low, least_s * task.network.power_w(least_s, bits) / best.cost_w)
    fails = _failing(task, theorem, bits, low)
    if fails is not None:
        narrow_s = SLOT_SHARE * least_s
        if best is not None or _failing(task, theorem, bits, narrow_s) is not None:
            return _Failed(fails[1], SHARP_ORDER.get(fails[0], 0))
        # Narrower slots would do: the payload is what is too large.
        widest_s, _ = _halved(task, theorem, bits, narrow_s, least_s)
        return _Failed(Inequality(PAYLOAD_FITS, least_s, widest_s, "s"), SHARP_ORDER["payload"])
    high = 2.0 * low
    while _failing(task, theorem, bits, high) is None:
        low, high = high, 2.0 * high
    low, high = _halved(task, theorem, bits, low, high)
    fails = _failing(task, theorem, bits, high)
    assert fails is not None
    return _Found(low, 1, (fails[0],))


def _halved(
    task: DesignTask, theorem: Theorem, bits: int, low: float, high: float
) -> tuple[float, float]:
    """The widest slot that a sharp design may have, and one that is just too wide."""
    while high - low > SLOT_SHARE * high:
        middle = 0.5 * (low + high)
        fails = _failing(task, theorem, bits, middle)
        low, high = (middle, high) if fails is None else (low, middle)
    return low, high


def _failing(
    task: DesignTask, theorem: Theorem, bits: int, slot_s: float
) -> tuple[str, Inequality] | None:
    """Return what a sharp design with this slot misses first: its name, the inequality."""
    assert task.capture_radius_m is not None and task.deadline_s is not None
    found = guarantees(task.chase, task.network.service(slot_s, bits).bounds)[theorem]
    for each in found.inequalities:
        if not each.holds:
            return theorem.value, each
    caught = found.captures(task.capture_radius_m)
    if not caught.holds:
        return "capture_radius", caught
    lasts_s = found.capture_time_s(_first_distance_m(task), task.capture_radius_m)
    in_time = Inequality(IN_TIME, lasts_s, task.deadline_s, "s")
    return None if in_time.holds else ("deadline", in_time)


def _widest_s(task: DesignTask, bits: int) -> float | _Failed:
    """The widest slot by the Lemma, or what keeps the payload out of it."""
    room = task.room(bits)
    shrinks = Inequality("a + margin below 1", 1.0 - room, 1.0)
    if not shrinks.holds:
        return _Failed(shrinks, 0)
    widest_s = room / task.staleness_per_slot
    fits = Inequality(PAYLOAD_FITS, task.network.least_slot_s(bits), widest_s, "s")
    return widest_s if fits.holds else _Failed(fits, 1)


def _left(task: DesignTask, bits: int) -> float:
    """1 - a."""
    return task.room(bits) + task.margin


def _driving_s(task: DesignTask, bits: int) -> float:
    """``(1 + kappa) d / (alpha v_e)``: the longest first stage."""
    first_m = (1.0 + relative_error(bits)) * _first_distance_m(task)
    return first_m / task.chase.pursuer_speed_m_s


def _first_distance_m(task: DesignTask) -> float:
    if task.first_distance_m is None:
        raise InputError("the time to capture needs a first distance", key="first_distance_m")
    return task.first_distance_m


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
