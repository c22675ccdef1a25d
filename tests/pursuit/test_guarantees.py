"""The four theorems: closed forms, worst cases by sampling, and the inequalities that they name."""

from fractions import Fraction
from math import isinf

import numpy as np
import pytest

from planopt.pursuit import (
    Chase,
    Distances,
    Inequality,
    ServiceBounds,
    SnapshotService,
    Theorem,
    capture_guarantees,
    contraction,
    guarantees_among_obstacles,
)

CHASES = [Chase(1.0, 2.0), Chase(2.5, 3.5, 0.3), Chase(0.4, 2.0, 0.05)]
BOUNDS = [
    ServiceBounds(0.1, 0.1),
    ServiceBounds(0.05, 0.08, 1.5, 0.7),
    ServiceBounds(0.2, 0.05, 0.01, 2.0, period_s_m=0.1, spacing_m=1.0),
    ServiceBounds(0.0, 0.12, 4.0, 0.01, period_s_m=0.0, spacing_m=1.0),
]


def test_contraction_is_the_lemmas():
    """1/alpha + kappa (1 + 1/alpha) = (alpha + k + 1) / (k alpha), in whole numbers."""
    for alpha, k in ((Fraction(2), Fraction(7, 2)), (Fraction(6, 5), Fraction(40))):
        assert 1 / alpha + (1 + 1 / alpha) / k == (alpha + k + 1) / (k * alpha)
        found = contraction(float(alpha), float(1 / k))
        assert found == pytest.approx(float((alpha + k + 1) / (k * alpha)))
        # a < 1 if and only if k > (alpha + 1) / (alpha - 1).
        assert (found < 1) == (k > (alpha + 1) / (alpha - 1))


def worst_by_sampling(theorem, chase, bounds, bound_m, generator, count=40_000):
    """Largest W after a stage over random ages, errors and directions that are allowed."""
    evader, pursuer = chase.evader_speed_m_s, chase.pursuer_speed_m_s
    d = bound_m * generator.random(count)
    d[: count // 4] = bound_m / (1.0 + bounds.age_s_m * evader)
    d[count // 4 : count // 2] = max(0.0, bound_m - evader * bounds.age_floor_s)
    d[count // 2 : 3 * count // 4] = bound_m * (1.0 - bounds.age_s_m * evader)
    age = (bound_m - d) / evader
    reference = d if theorem is Theorem.SAMPLED_DISTANCE else np.full(count, bound_m)
    allowed = age <= np.maximum(bounds.age_s_m * reference, bounds.age_floor_s) * (1 + 1e-12)
    error = np.maximum(bounds.relative_error * reference, bounds.error_floor_m)
    # Drive beyond the sampled place by the error, while the evader runs the other way.
    lasts = (d + error) / pursuer + chase.stage_delay_s
    after = error + evader * (age + lasts)
    return after[allowed & (d >= 0.0)].max()


@pytest.mark.parametrize("theorem", [Theorem.ANY_INSTANT, Theorem.SAMPLED_DISTANCE])
@pytest.mark.parametrize("bounds", BOUNDS)
@pytest.mark.parametrize("chase", CHASES)
def test_bound_of_a_stage_is_the_worst_case(theorem, chase, bounds):
    """No stage of driving ends higher, and some end there."""
    found = capture_guarantees(chase, bounds)[theorem]
    generator = np.random.default_rng(0)
    for bound_m in (0.5, 3.0, 20.0, 400.0):
        drive, _ = found.stages[0](np.array(bound_m))
        worst = worst_by_sampling(theorem, chase, bounds, bound_m, generator)
        assert worst <= drive * (1 + 1e-9)
        # At small W no place is that near and the age that old: the bound is not reached.
        if bound_m > 2 * chase.evader_speed_m_s * bounds.age_floor_s:
            assert worst >= drive * (1 - 1e-3)


@pytest.mark.parametrize("chase", CHASES[:1])
def test_times_without_floors(chase):
    """Closed forms of equations 8.3 and 8.5, at 1000 m."""
    bounds, first = ServiceBounds(0.15, 0.1), 1000.0
    found = capture_guarantees(chase, bounds)
    a, x, kappa, alpha = contraction(2.0, 0.1), 0.15, 0.1, 2.0
    lemma = (1 + kappa) * first / alpha / (1 - a - x)
    assert found[Theorem.LEMMA].capture_time_s(first, 1.0) == pytest.approx(lemma, rel=1e-9)
    trail = (1 + kappa) * (1 + x) * first / alpha / (1 - a)
    assert found[Theorem.SAMPLED_DISTANCE].capture_time_s(first, 1.0) == pytest.approx(trail)
    any_instant = (1 - x + kappa) * (1 + x) * first / alpha / (1 - a - (1 - 1 / alpha) * x)
    assert found[Theorem.ANY_INSTANT].capture_time_s(first, 1.0) == pytest.approx(any_instant)
    ratios = {theorem: each.ratio for theorem, each in found.items()}
    assert ratios == pytest.approx(
        {
            Theorem.LEMMA: a + x,
            Theorem.ANY_INSTANT: a + x / 2,
            Theorem.SAMPLED_DISTANCE: (a + x) / (1 + x),
        }
    )
    assert all(each.floor_m == 0.0 for each in found.values())


@pytest.mark.parametrize("bounds", BOUNDS)
@pytest.mark.parametrize("chase", CHASES)
def test_floors(chase, bounds):
    """Closed forms: the largest of those with either bound at its floor, or both."""
    found = capture_guarantees(chase, bounds)
    u, v = 1 / chase.speed_ratio, chase.evader_speed_m_s
    kappa, x = bounds.relative_error, bounds.age_s_m * v
    moved, error = v * bounds.age_floor_s, bounds.error_floor_m
    delay = v * chase.stage_delay_s
    a = u + kappa * (1 + u)
    trail = found[Theorem.SAMPLED_DISTANCE]
    if a < 1:
        d = max(((1 + u) * error + delay) / (1 - u), delay / (1 - a))
        assert trail.floor_m == pytest.approx(max(d * (1 + x), d + moved), abs=1e-9)
    any_instant = found[Theorem.ANY_INSTANT]
    if any_instant.holds:
        offsets = [
            ((1 + u) * e + (1 - u) * m + delay)
            / (1 - u - (1 + u) * kappa * (e == 0) - (1 - u) * x * (m == 0))
            for e in (error, 0.0)
            for m in (moved, 0.0)
        ]
        assert any_instant.floor_m >= max(offsets) - 1e-9
        # Waiting may only lift it where the age's floor alone is large.
        if moved < 0.1:
            assert any_instant.floor_m == pytest.approx(max(offsets), abs=1e-9)
    for each in found.values():
        if not each.holds:
            assert isinf(each.floor_m) and isinf(each.capture_time_s(50.0, 1e3))
            continue
        floor = np.array(max(each.floor_m, 1e-6))
        if each.theorem is Theorem.LEMMA:
            continue
        assert each.next_bound_m(1.001 * floor) <= 1.001 * floor
        assert each.next_bound_m(0.999 * floor) >= 0.999 * floor or each.floor_m == 0.0
        assert isinf(each.capture_time_s(50.0, 0.99 * float(floor))) or each.floor_m == 0.0


def test_limits_of_the_slot_width():
    """The Lemma, any instant and snapshots allow slots in the ratio (1 - 1/alpha) : 1 : 2."""
    chase = Chase(1.0, 2.0)

    def limit(theorem):
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            bounds = SnapshotService(6, 1.0, middle, 6).bounds
            holds = capture_guarantees(chase, bounds)[theorem].holds
            low, high = (middle, high) if holds else (low, middle)
        return low

    lemma = limit(Theorem.LEMMA)
    # Equation 8.3: slots a frame times slot width below (1 - a) / (12 v_e).
    k = 2**6 / np.sqrt(2)
    assert lemma == pytest.approx((1 - (2 + k + 1) / (k * 2)) / 12)
    assert limit(Theorem.ANY_INSTANT) == pytest.approx(2 * lemma)
    # Growth while waiting binds a little earlier than a of the lagging error.
    assert 3.2 * lemma < limit(Theorem.SNAPSHOTS) < 4 * lemma
    assert limit(Theorem.SAMPLED_DISTANCE) == pytest.approx(1.0)


def test_inequalities_say_by_how_much():
    each = Inequality("floor below the capture radius", 5.25, 5.0, "m")
    assert str(each) == "floor below the capture radius: 5.25 m is not below 5 m"
    assert not each.holds and each.margin == -0.25
    found = capture_guarantees(Chase(1.0, 2.0), ServiceBounds(0.4, 0.1))
    assert str(found[Theorem.LEMMA].inequalities[0]) == "a + x below 1: 1.05 is not below 1"
    slow = capture_guarantees(Chase(1.0, 1.2), ServiceBounds(0.0, 0.2))[Theorem.SAMPLED_DISTANCE]
    assert not slow.holds and slow.inequalities[0].margin == pytest.approx(-0.2)


def test_period_of_one_evader_step():
    """Where an evader leaves every cell within a period, rounds say nothing."""
    found = capture_guarantees(
        Chase(1.0, 2.0), ServiceBounds(2.0, 0.1, period_s_m=1.0, spacing_m=1.0)
    )
    assert Theorem.SNAPSHOTS in found and not found[Theorem.SNAPSHOTS].holds
    assert "period" in str(found[Theorem.SNAPSHOTS].inequalities[0])
    assert Theorem.SNAPSHOTS not in capture_guarantees(Chase(1.0, 2.0), ServiceBounds(2.0, 0.1))


@pytest.mark.parametrize("speeds", [(1.0, 1.0), (2.0, 1.5), (2.0, 1.0)])
@pytest.mark.parametrize("age_s_m", [0.0, 5.0])
def test_evader_as_fast_as_its_pursuer(speeds, age_s_m):
    """No theorem holds, however old or fresh the records are."""
    bounds = ServiceBounds(age_s_m, 0.1, period_s_m=0.1, spacing_m=1.0)
    found = capture_guarantees(Chase(*speeds), bounds)
    among = guarantees_among_obstacles(Chase(*speeds), bounds, 2.0)
    assert set(found) == set(Theorem) == set(among[Distances.PATHS])
    for each in (*found.values(), *among[Distances.PATHS].values()):
        assert not each.holds and each.capture_time_s(10.0, 5.0) == np.inf
        assert "evader's speed below the pursuer's" in str(each.inequalities[0])
