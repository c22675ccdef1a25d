"""Co-design: the published example, scans against programmes and grids, and what is impossible."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from refusals import refused
from scipy.optimize import minimize_scalar

from planopt.pursuit import (
    MAX_BITS,
    Chase,
    DesignTask,
    MoteNetwork,
    NoDesignError,
    SnapshotService,
    Theorem,
    capture_guarantees,
    cheapest_design,
    cheapest_rated_design,
    least_energy_design,
    pareto_front,
    relative_error,
    relaxed_design,
    sensitivities,
    sharp_design,
    simulate_flooding,
)

NETWORK = MoteNetwork(
    levels=6,
    mote_spacing_m=1.0,
    bit_rate_bit_s=250e3,
    header_bits=64,
    record_bits=16,
    energy_j_per_bit=1e-6,
    slot_blocks=6,
)


def radio(**changes):
    return NETWORK.model_copy(update=changes)


TASK = DesignTask(NETWORK, Chase(1.0, 2.0), margin=0.0)
OTHER = DesignTask(
    radio(mote_spacing_m=5.0, levels=8, record_bits=4, idle_w=2e-4, slot_blocks=14),
    Chase(1.2, 4.0),
    margin=0.02,
    first_distance_m=200.0,
    capture_radius_m=20.0,
    deadline_s=200.0,
)
TASKS = [TASK, OTHER]


def widest_s(task, bits):
    """The widest slot that the Lemma allows at r = 1."""
    return task.room(bits) / task.staleness_per_slot


def fixed(task, bits):
    return replace(task, bits_per_axis=bits)


def test_example_by_hand():
    """Alpha 2, 4096 motes, 1 uJ a bit: 40.8, 27.7, 24.8, 24.29, 24.7, 25.4 W for c from 3 to 8."""
    found = [cheapest_design(fixed(TASK, c)).cost_w for c in range(3, 9)]
    np.testing.assert_allclose(found, [40.81, 27.68, 24.79, 24.29, 24.67, 25.44], atol=5e-3)
    for c, cost in zip(range(3, 9), found, strict=True):
        k = 2**c / np.sqrt(2)
        slot = (1 - (2 + k + 1) / (k * 2)) / (12 * 9)
        bits = 64 + 3 * (16 + 2 * c) * (2 - 2**-6)
        assert cost == pytest.approx(4096 * 1e-6 * bits / (9 * slot), rel=1e-12)
    best = cheapest_design(TASK)
    assert (best.bits_per_axis, best.binding) == (6, ("lemma",))
    assert best.cost_w == pytest.approx(24.2876, abs=5e-5)
    for c in (1, 2):
        with refused(NoDesignError):
            cheapest_design(fixed(TASK, c))


def test_the_lemmas_limit_exactly():
    """The slot of the optimum is the Lemma's limit, and with a margin the Lemma holds."""
    service = cheapest_design(TASK)
    limit_s = widest_s(TASK, service.bits_per_axis)
    assert service.slot_width_s == pytest.approx(limit_s, rel=1e-14)
    found = cheapest_design(replace(TASK, margin=0.01))
    lemma = found.guarantees[Theorem.LEMMA]
    assert lemma.holds and lemma.inequalities[0].margin == pytest.approx(0.01)
    at_most = replace(TASK, margin=1e-9)
    assert cheapest_design(at_most).guarantees[Theorem.LEMMA].holds


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("bits", [3, 6, 11])
def test_programme_at_each_number_of_bits(task, bits):
    """Scan and convex programme agree to 1e-6 in cost and slot."""
    scanned = cheapest_design(fixed(task, bits))
    solved = relaxed_design(task, bits_per_axis=bits)
    assert solved.cost_w == pytest.approx(scanned.cost_w, rel=1e-6)
    assert solved.slot_width_s == pytest.approx(scanned.slot_width_s, rel=1e-6)
    assert solved.rate_divisor == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("task", TASKS)
def test_relaxation_is_a_lower_bound(task):
    """Continuous compression costs no more, 24.2855 against 24.2876 W in the example.

    Its optimum is that of a search over kappa alone.
    """
    relaxed = relaxed_design(task)
    assert relaxed.cost_w <= cheapest_design(task).cost_w
    if task is TASK:
        assert relaxed.cost_w == pytest.approx(24.2855, abs=5e-5)

    def cost(bits):
        return task.network.power_w(task.room(bits) / task.staleness_per_slot, bits)

    searched = minimize_scalar(cost, bounds=(3.0, 14.0), method="bounded", options={"xatol": 1e-9})
    assert relaxed.cost_w == pytest.approx(searched.fun, rel=1e-7)
    assert relaxed.relative_error == pytest.approx(np.sqrt(2) * 2**-searched.x, rel=1e-3)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("bits", [4, 9])
@pytest.mark.filterwarnings("ignore:Solver failed:RuntimeWarning", "ignore:Solution may be")
def test_disciplined_quasiconvex_programme(task, bits):
    """Bisection over levels (DQCP, Clarabel) finds the scan's least power to 1e-6.

    With y = -ln kappa the bits are linear, and power is a ratio of linear functions.
    """
    network, u = task.network, 1.0 / task.chase.speed_ratio
    unit_s = (1.0 - u - task.margin) / task.staleness_per_slot
    slot, y = cp.Variable(pos=True), cp.Variable(pos=True)
    block = network.record_bits + 1.0 + 2.0 / np.log(2.0) * y
    payload = network.header_bits + network.slot_blocks * block
    limits = [
        task.staleness_per_slot * unit_s * slot + (1.0 + u) * cp.exp(-y) <= 1.0 - u - task.margin,
        payload <= network.bit_rate_bit_s * unit_s * slot,
        y == -np.log(relative_error(bits)),
    ]
    sent = (network.header_bits + network.mean_blocks * block) / network.frame_bits(4)
    programme = cp.Problem(cp.Minimize(sent / slot), limits)
    assert programme.is_dqcp() and not programme.is_dcp()
    programme.solve(qcp=True, solver=cp.CLARABEL, low=0.2, high=50.0, eps=4e-7)
    cost_w = network.power_w(unit_s * slot.value, 0.5 + y.value / np.log(2.0))
    assert cost_w == pytest.approx(cheapest_design(fixed(task, bits)).cost_w, rel=1e-6)


@pytest.mark.parametrize("task", TASKS)
def test_slow_rounds(task):
    """Short slots and slow rounds cost less, never less than the relaxation or half as much."""
    plain, rated = cheapest_design(task), cheapest_rated_design(task)
    relaxed = relaxed_design(task, rated=True)
    idle = task.network.motes * task.network.idle_w
    assert 0.5 * (plain.cost_w - idle) < rated.cost_w - idle < plain.cost_w - idle
    assert relaxed.cost_w <= rated.cost_w * (1 + 1e-9)
    assert relaxed.cost_w > rated.cost_w * 0.95
    assert rated.slot_width_s >= task.network.least_slot_s(rated.bits_per_axis)
    bounds = task.network.service(
        rated.slot_width_s, rated.bits_per_axis, rated.rate_divisor
    ).bounds
    x = bounds.age_s_m * task.chase.evader_speed_m_s
    assert x == pytest.approx(task.room(rated.bits_per_axis), rel=1e-12)
    # For a number of bits, y = r s and s are known in closed form.
    for bits in (4, 7):
        least_s = task.network.least_slot_s(bits)
        y_s = 2.0 * task.room(bits) / task.staleness_per_slot - least_s
        solved = relaxed_design(task, rated=True, bits_per_axis=bits)
        assert solved.slot_width_s == pytest.approx(least_s, rel=1e-6)
        assert solved.rate_divisor == pytest.approx(y_s / least_s, rel=1e-6)
        cost = task.network.power_w(least_s, bits, y_s / least_s)
        assert solved.cost_w == pytest.approx(cost, rel=1e-6)


@pytest.mark.parametrize("idle_w", [0.0, 1e-4, 1e-2])
@pytest.mark.parametrize("bits", [4, 6, 9])
def test_energy_by_grid(idle_w, bits):
    """With idling motes too: no slot of a grid needs less."""
    task = fixed(
        replace(TASK, network=radio(idle_w=idle_w), margin=0.005, first_distance_m=30.0), bits
    )
    found = least_energy_design(task)
    least_s, most_s = NETWORK.least_slot_s(bits), widest_s(task, bits)
    kappa = np.sqrt(2) * 2.0**-bits
    slots = np.linspace(least_s, most_s, 20_001)
    left = 1 - (0.5 + 1.5 * kappa) - 108 * slots
    power = np.array([task.network.power_w(slot, bits) for slot in slots])
    energy = power * (1 + kappa) * 30.0 / 2.0 / left
    assert found.energy_per_capture_j <= energy.min() * (1 + 1e-12)
    assert found.energy_per_capture_j == pytest.approx(energy.min(), rel=1e-6)


def test_pareto_front():
    """Every design meets its deadline; no slot and bits of a grid beat one in both."""
    task = replace(TASK, margin=0.01, first_distance_m=30.0)
    front = pareto_front(task, np.geomspace(30.0, 300.0, 25))
    times = np.array([design.capture_time_s for design in front])
    energies = np.array([design.energy_per_capture_j for design in front])
    deadlines = np.array([design.task.deadline_s for design in front])
    assert (times <= deadlines * (1 + 1e-9)).all()
    assert (np.diff(times) > 0).all() and (np.diff(energies) < 0).all()
    assert energies[-1] == pytest.approx(least_energy_design(task).energy_per_capture_j)
    for bits in range(3, MAX_BITS + 1):
        kappa = np.sqrt(2) * 2.0**-bits
        for slot in np.linspace(NETWORK.least_slot_s(bits), widest_s(task, bits), 300):
            left = 1 - (0.5 + 1.5 * kappa) - 108 * slot
            time = (1 + kappa) * 15.0 / left
            energy = NETWORK.power_w(slot, bits) * time
            assert (energy >= energies[deadlines >= time] * (1 - 1e-12)).all()


@pytest.mark.parametrize("theorem", list(Theorem))
def test_sharp_design(theorem):
    """The widest slot that the theorem allows: it holds there, and not a thousandth beyond."""
    found = sharp_design(OTHER, theorem)
    assert found.guarantees[theorem].holds
    wider = OTHER.network.service(1.001 * found.slot_width_s, found.bits_per_axis).bounds
    for bounds, met in (
        (OTHER.network.service(found.slot_width_s, found.bits_per_axis).bounds, True),
        (wider, False),
    ):
        guarantee = capture_guarantees(OTHER.chase, bounds)[theorem]
        caught = guarantee.holds and guarantee.captures(20.0).holds
        assert (caught and guarantee.capture_time_s(200.0, 20.0) < 200.0) == met
    assert len(found.binding) == 1


def test_sharper_theorems_cost_less():
    """The trail's theorem needs the least, the Lemma the most."""
    costs = {theorem: sharp_design(OTHER, theorem).cost_w for theorem in Theorem}
    assert costs[Theorem.SAMPLED_DISTANCE] < costs[Theorem.SNAPSHOTS]
    assert costs[Theorem.SNAPSHOTS] < costs[Theorem.ANY_INSTANT] < costs[Theorem.LEMMA]


def test_sensitivities():
    """Change of power in per cent by one per cent: against derivatives of the closed form."""
    task = replace(TASK, margin=0.01)
    found = sensitivities(task, cheapest_design)
    bits = cheapest_design(task).bits_per_axis
    kappa = np.sqrt(2) * 2.0**-bits
    driven = 0.5 * (1 + kappa) / task.room(bits)
    payload = NETWORK.mean_blocks * np.array([16.0, 2.0 * bits])
    expected = {
        # Twice as it moves farther while records age, and as the ratio of speeds falls.
        "evader_speed_m_s": 1 + driven,
        "pursuer_speed_m_s": -driven,
        "bit_rate_bit_s": 0.0,
        "header_bits": 64 / (64 + payload.sum()),
        "record_bits": payload[0] / (64 + payload.sum()),
        "mote_spacing_m": -1.0,
    }
    assert found == pytest.approx(expected, abs=1e-6)
    slow = replace(OTHER, deadline_s=1e4, capture_radius_m=9.0)
    found = sensitivities(slow, sharp_design)
    assert found["evader_speed_m_s"] > 0 > found["pursuer_speed_m_s"]


def test_fewer_relays_cost_less():
    """Six blocks a slot, the mean load, keep the rounds without border relays but not with them."""
    service = SnapshotService(5, 1.0, 0.01, 3)
    assert simulate_flooding(service, slot_blocks=6).late.any()
    assert not simulate_flooding(service, border_relays=False, slot_blocks=6).late.any()
    lean = replace(TASK, network=radio(border_relays=False, slot_blocks=6))
    assert cheapest_design(lean).cost_w < 0.6 * cheapest_design(TASK).cost_w
