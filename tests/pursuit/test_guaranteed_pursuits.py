"""Simulated pursuits against the guarantees: every stage below its bound, every capture in time."""

import numpy as np
import pytest
from adversary import AdversarialRecords
from pursuit_scene import pursue

from planopt.pursuit import (
    Chase,
    Fleeing,
    Foresighted,
    ServiceBounds,
    SnapshotRecords,
    SnapshotService,
    Static,
    Theorem,
    Wandering,
    Zigzag,
    capture_guarantees,
    contraction,
)

BEHAVIOURS = [
    Static(),
    Wandering(),
    Fleeing(),
    Fleeing(from_aims=True),
    Zigzag(period_s=4.0),
    Foresighted(horizon=4, plan_step_s=1.0),
]


def above_bound(pursuit, guarantee):
    """Largest W of a stage over what the one before allows; 0 for a single stage."""
    bounds = pursuit.bounds_m(0, 0)
    if len(bounds) < 2:
        return 0.0
    return float((bounds[1:] / guarantee.next_bound_m(bounds[:-1])).max())


@pytest.mark.parametrize("behaviour", BEHAVIOURS, ids=lambda each: type(each).__name__)
@pytest.mark.parametrize(
    ("speed_ratio", "bits", "x", "divisor", "theorems"),
    [
        (2.0, 4, 0.25, 1, {Theorem.LEMMA, Theorem.ANY_INSTANT, Theorem.SNAPSHOTS}),
        (3.0, 3, 0.6, 1, {Theorem.ANY_INSTANT, Theorem.SNAPSHOTS}),
        (3.0, 5, 1.2, 1, {Theorem.SNAPSHOTS}),
        (1.5, 6, 0.3, 2, {Theorem.ANY_INSTANT, Theorem.SNAPSHOTS}),
    ],
)
def test_snapshots(behaviour, speed_ratio, bits, x, divisor, theorems):
    """On an endless grid: whatever theorem holds bounds every stage and the time to capture."""
    # sigma v_e = 6 (1 + r) frames a spacing, for an evader that moves one spacing a second.
    service = SnapshotService(
        11, 1.0, x / (6 * (1 + divisor)), bits, rate_divisor=divisor, endless=True
    )
    radius_m = 1.05 * _floor_m(service, speed_ratio)
    chase = Chase(1.0, speed_ratio, 0.1 * radius_m / speed_ratio)
    found = capture_guarantees(chase, service.bounds)
    holding = {theorem for theorem, each in found.items() if each.holds}
    assert holding == theorems | {Theorem.SAMPLED_DISTANCE}
    for seed in range(2):
        pursuit = pursue(
            SnapshotRecords(service),
            behaviour,
            seed,
            speeds=(1.0, speed_ratio),
            radius_m=radius_m,
            distance_m=40.0,
        )
        assert pursuit.outcome == "captured"
        for theorem in holding & {Theorem.ANY_INSTANT, Theorem.SNAPSHOTS}:
            assert above_bound(pursuit, found[theorem]) <= 1.0
            first_m = pursuit.uses[0].distance_m
            if found[theorem].captures(radius_m).holds:
                assert pursuit.capture_time_s <= found[theorem].capture_time_s(first_m, radius_m)


def _floor_m(service, speed_ratio):
    """The floor of the snapshots' theorem where steps are a tenth of it: a fixed point."""
    floor_m = 1.0
    for _ in range(12):
        chase = Chase(1.0, speed_ratio, 0.105 * floor_m / speed_ratio)
        floor_m = capture_guarantees(chase, service.bounds)[Theorem.SNAPSHOTS].floor_m
    return floor_m


@pytest.mark.parametrize(
    "behaviour",
    [Fleeing(), Fleeing(from_aims=True), Zigzag(period_s=3.0), Wandering(turn_std_rad=1.0)],
)
@pytest.mark.parametrize(
    ("speed_ratio", "k", "x"), [(2.0, 3.5, 0.02), (2.0, 3.5, 2.0), (1.5, 8.0, 0.1), (3.0, 4.0, 1.0)]
)
def test_adversarial_records(behaviour, speed_ratio, k, x):
    """Records as bad as allowed: under rule R a < 1 captures for any x, within its bounds."""
    bounds = ServiceBounds(x, 1.0 / k, 0.01, 0.1)
    chase = Chase(1.0, speed_ratio, 0.1 / speed_ratio)
    found = capture_guarantees(chase, bounds)
    trail = found[Theorem.SAMPLED_DISTANCE]
    for seed in range(2):
        pursuit = pursue(
            AdversarialRecords(bounds, chase),
            behaviour,
            seed,
            speeds=(1.0, speed_ratio),
            radius_m=1.01 * trail.floor_m,
            step_s=chase.stage_delay_s,
        )
        assert pursuit.outcome == "captured"
        assert above_bound(pursuit, trail) <= 1.0
        limit_s = trail.capture_time_s(pursuit.uses[0].distance_m, 1.01 * trail.floor_m)
        assert pursuit.capture_time_s <= limit_s
        if found[Theorem.ANY_INSTANT].holds:
            assert above_bound(pursuit, found[Theorem.ANY_INSTANT]) <= 1.0
        if found[Theorem.LEMMA].holds:
            sampled = np.array([use.distance_m for use in pursuit.uses])
            if len(sampled) > 1:
                limits = found[Theorem.LEMMA].next_bound_m(sampled[:-1])
                assert (sampled[1:] <= limits).all()


def test_floor_grows_with_staleness():
    """An evader keeps away for ever at twice v_e A_0 + eps_0 (alpha + 1) / (alpha - 1).

    That sum bounds W only while ages are at their floor; ages that grow with the distance lift it.
    """
    bounds = ServiceBounds(3.0, 0.0, 1e-6, 1.0)
    chase = Chase(1.0, 2.0, 0.01)
    sum_of_floors = 1e-6 + 1.0 * (2.0 + 1.0) / (2.0 - 1.0)
    floor_m = capture_guarantees(chase, bounds)[Theorem.SAMPLED_DISTANCE].floor_m
    assert floor_m > 4.0 * sum_of_floors
    near = pursue(
        AdversarialRecords(bounds, chase),
        Fleeing(),
        0,
        radius_m=1.4 * sum_of_floors,
        step_s=0.01,
        max_steps=12_000,
    )
    assert near.outcome == "step_limit"
    far = pursue(AdversarialRecords(bounds, chase), Fleeing(), 0, radius_m=floor_m, step_s=0.01)
    assert far.outcome == "captured"


def test_order_is_needed():
    """Records older than the last one send a pursuer back along the trail: it never captures.

    Though a < 1: that some record is no older is a premise of the theorem.
    """
    bounds, chase = ServiceBounds(2.0, 1 / 3.5, 0.01, 0.1), Chase(1.0, 2.0, 0.05)
    assert contraction(2.0, 1 / 3.5) < 1.0
    for in_order, outcome in ((True, "captured"), (False, "step_limit")):
        source = AdversarialRecords(bounds, chase, in_order)
        pursuit = pursue(source, Fleeing(), 0, radius_m=5.0, step_s=0.05, max_steps=3000)
        assert pursuit.outcome == outcome
