"""Bounds of pursuits level by level, against an evader that optimises its headings."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planopt.pursuit import Chase, LevelBounds, SnapshotService, Theorem, capture_guarantees

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
KAPPA, HALF_DIAGONAL = math.sqrt(2.0) / 32.0, math.sqrt(0.5)


def bounds(lag=0.3, alpha=2.5, error=KAPPA, least_error_m=HALF_DIAGONAL, divisor=1, **other):
    """Unit cells, an evader of 1 m/s, and the lag y."""
    period_s = 0.5 * lag
    return LevelBounds(
        1.0, alpha, other.pop("delay_s", 0.0), 1.0, period_s / divisor, period_s, error,
        least_error_m, **other,
    )  # fmt: skip


CASES = [
    bounds(),
    bounds(0.6, 4.0),
    bounds(0.2, 1.6, 0.01, divisor=3),
    bounds(0.4, 3.0, 0.17, 0.7, delay_s=0.1),
]


@pytest.mark.parametrize("case", CASES)
def test_floor_is_the_last_bound_that_a_stage_may_lift(case):
    grid = np.geomspace(0.01, 1e4, 200_001)
    lifted = grid[case.next_bound_m(grid) >= grid]
    assert lifted.max() == pytest.approx(case.floor_m(), rel=2e-4)
    assert math.isinf(case.capture_time_s(50.0, 0.999 * case.floor_m()))
    assert math.isfinite(case.capture_time_s(50.0, 1.001 * case.floor_m()))


def test_exact_reports_reach_the_bound_of_every_pursuer():
    """Nobody catches a fleeing evader before (W - r) / (v_p - v_e); without errors drivers do."""
    case = bounds(error=0.0, least_error_m=0.0)
    for first_m in (5.0, 40.0, 300.0):
        lasts_s = (case.start_m(first_m) - 2.0) / (2.5 - 1.0)
        assert case.capture_time_s(first_m, 2.0) == pytest.approx(lasts_s)


@pytest.mark.parametrize("case", CASES)
def test_every_stage_by_random_geometry(case):
    """No sample, next finer sample, error and flight that the rounds allow ends above the bound."""
    generator = np.random.default_rng(0)
    count = 200_000
    level = generator.integers(1, 8, count)
    finer_s, size = case.round_s * 2.0 ** (level - 1), 2.0 ** (level - 1)
    periods = generator.integers(0, 3, count)
    age_finer_s = finer_s + case.period_s * size * generator.random(count)
    gap_s = periods * case.period_s * size
    age_s = age_finer_s + gap_s
    possible = (age_s >= 2 * finer_s) & (age_s <= 2 * finer_s + 2 * case.period_s * size)
    turn, aside, off = generator.uniform(0.0, 2.0 * np.pi, (3, count))
    seen_m = size * np.exp(generator.uniform(-0.7, 1.0, count))
    seen = np.stack([seen_m, np.zeros(count)], axis=1)
    finer = seen + gap_s[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    possible &= np.linalg.norm(finer, axis=1) >= size
    error_m = np.maximum(case.error * size, case.least_error_m)
    reported = seen + error_m[:, None] * np.stack([np.cos(aside), np.sin(aside)], axis=1)
    drive_s = np.linalg.norm(reported, axis=1) / case.pursuer_m_s + case.delay_s
    flown = (age_finer_s + drive_s)[:, None] * np.stack([np.cos(off), np.sin(off)], axis=1)
    after_m = np.linalg.norm(finer + flown - reported, axis=1)
    allowed_m = case.next_bound_m(seen_m + age_s)
    assert possible.sum() > 20_000
    assert (after_m <= allowed_m * (1 + 1e-9))[possible].all()
    # Some come near.
    assert (after_m / allowed_m)[possible].max() > 0.85


@pytest.mark.parametrize(("alpha", "bits", "radius"), [(2.5, 5, 5.0), (4.0, 6, 8.0)])
def test_optimised_evader(alpha, bits, radius, monkeypatch):
    """At twice the least record rate the time is at most 1.5 times what an evader reaches."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    from pursuit_adversary import Rounds, guarantee_of, least_rate_s, worst

    round_s = 0.5 * least_rate_s(alpha, bits, radius)
    guarantee = guarantee_of(alpha, bits, round_s)
    limit_s = guarantee.capture_time_s(30.0, radius)
    rounds = Rounds(11, round_s, 1, bits)
    found = worst(rounds, alpha, radius, 30.0, 2.0 * limit_s, 0, population=60, generations=8)
    assert limit_s / 1.5 <= found.capture_s <= limit_s
    assert found.bounds_m[0] <= guarantee.levels.start_m(30.0)
    assert (found.bounds_m[1:] <= guarantee.next_bound_m(np.array(found.bounds_m[:-1]))).all()


@pytest.mark.parametrize("divisor", [1, 2, 5])
def test_random_evaders_stay_within_every_stage(divisor, monkeypatch):
    """Near the floor, where evaders escape longest, with rounds at every r-th time too."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    from pursuit_adversary import Rounds, chased, guarantee_of

    generator = np.random.default_rng(divisor)
    seen = 0
    for _ in range(400):
        alpha, bits = generator.uniform(1.3, 4.0), int(generator.integers(3, 8))
        round_s = 0.5 * generator.uniform(0.05, 0.7) / divisor
        guarantee = guarantee_of(alpha, bits, round_s, divisor)
        if not guarantee.holds:
            continue
        radius = 1.02 * guarantee.floor_m
        first_m = radius * generator.uniform(1.5, 12.0)
        limit_s = guarantee.capture_time_s(first_m, radius)
        level = int(generator.integers(0, 2 + int(np.log2(first_m))))
        start = generator.uniform(0.0, 1.0, 4) * (1.0, 1.0, 1.0, 2.0 * np.pi)
        headings = generator.normal(0.0, 0.8, 40).tolist()
        rounds = Rounds(11, round_s, divisor, bits)
        leg_s = round_s * 2.0 ** max(0, level - 2)
        found = chased(
            rounds, alpha, radius, start.tolist(), level, first_m, headings, leg_s, 2 * limit_s
        )
        if found is None:
            continue
        seen += 1
        bound = np.array(found.bounds_m)
        assert found.capture_s <= limit_s
        assert (bound[1:] <= guarantee.next_bound_m(bound[:-1]) * (1 + 1e-9)).all()
    assert seen > 30


def test_scale():
    """Lengths and times scale; obstacles only lengthen the time."""
    case = bounds(delay_s=0.2)
    wide = replace(
        case, evader_m_s=2.0, pursuer_m_s=5.0, spacing_m=10.0, round_s=5 * case.round_s,
        period_s=5 * case.period_s, delay_s=1.0, least_error_m=10 * case.least_error_m,
    )  # fmt: skip
    assert wide.floor_m() == pytest.approx(10 * case.floor_m())
    lasts_s = case.capture_time_s(40.0, 6.0)
    assert wide.capture_time_s(400.0, 60.0) == pytest.approx(5 * lasts_s)
    assert replace(case, open_space=False).capture_time_s(40.0, 6.0) > lasts_s


def test_no_time_is_promised_beyond_the_reach_of_the_grid():
    """An evader outside the adjacent cells of the top level is never reported."""
    chase = Chase(1.0, 2.5)
    for levels, endless, promised in ((6, True, False), (9, True, True), (6, False, True)):
        service = SnapshotService(levels, 1.0, 0.05, 5, endless=endless)
        found = capture_guarantees(chase, service.bounds)[Theorem.SNAPSHOTS]
        assert math.isfinite(found.capture_time_s(60.0, 8.0)) == promised
