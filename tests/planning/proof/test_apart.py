"""What the verifier says of paths beside what moves, against places sampled densely."""

import numpy as np
import pytest

from planopt.planning.proof.motion import verify_apart
from planopt.world.motion import TimedMotion
from planopt.world.moving_discs import NOTHING_MOVES, MovingDiscs

STEPS = 4


def discs_of(centres_m, radius_m, least_m, is_robot):
    """Discs of constant radius."""
    count = len(centres_m)
    return MovingDiscs(
        tuple("abcdef"[:count]),
        np.asarray(centres_m, dtype=float),
        np.tile(np.asarray(radius_m, dtype=float)[:, None], (1, STEPS)),
        np.asarray(least_m, dtype=float),
        np.asarray(is_robot),
    )


@pytest.mark.parametrize("seed", range(6))
def test_least_distances_are_those_of_dense_samples(seed):
    """Of robots and of obstacles apart; the reasons name those that come too near."""
    generator = np.random.default_rng(seed)
    centres = np.cumsum(generator.normal(scale=2.0, size=(4, STEPS + 1, 2)), axis=1)
    path = np.cumsum(generator.normal(scale=2.0, size=(STEPS + 1, 2)), axis=0)
    radius, least = np.array([0.0, 0.0, 0.4, 0.9]), np.array([1.5, 1.5, 0.5, 0.5])
    discs = discs_of(centres, radius, least, [True, True, False, False])
    found = verify_apart(discs, TimedMotion(path))
    times = np.linspace(0.0, STEPS, 8001)
    own = np.stack([np.interp(times, range(STEPS + 1), path[:, a]) for a in (0, 1)])
    away = []
    for centre, size in zip(centres, radius, strict=True):
        other = np.stack([np.interp(times, range(STEPS + 1), centre[:, a]) for a in (0, 1)])
        away.append(np.hypot(*(own - other)) - size)
    lowest = np.array([values.min() for values in away])
    assert found.min_separation_m == pytest.approx(lowest[:2].min(), abs=2e-3)
    assert found.min_moving_clearance_m == pytest.approx(lowest[2:].min(), abs=2e-3)
    near = [name for name, low, asked in zip("abcd", lowest, least, strict=True) if low < asked]
    assert len(found.reasons) == len(near)
    for name, reason in zip(near, found.reasons, strict=True):
        number = "abcd".index(name)
        kind, key = (
            ("robot", "separation_m is 1.5")
            if number < 2
            else ("moving obstacle", "clearance_m is 0.5")
        )
        step = int(times[away[number].argmin()]) + 1
        assert f"of the {kind} {name}, constraints.{key}" in reason
        assert f"in step {step} " in reason or times[away[number].argmin()] % 1.0 in (0.0, 1.0)


def test_exactly_the_least_distance_is_enough():
    """And a hundredth of a millimetre less is not."""
    path = np.column_stack([np.arange(STEPS + 1.0), np.zeros(STEPS + 1)])
    for lower, count in ((0.0, 0), (1e-5, 1)):
        other = path + np.array([0.0, 2.0 - lower])
        discs = discs_of([other], [0.5], [1.5], [False])
        assert len(verify_apart(discs, TimedMotion(path)).reasons) == count


def test_nothing_moves():
    """Neither distance exists."""
    found = verify_apart(NOTHING_MOVES, TimedMotion(np.zeros((STEPS + 1, 2))))
    assert found.min_separation_m is None
    assert found.min_moving_clearance_m is None
    assert not found.reasons
