"""When assignments are made again, and what hysteresis leaves of them."""

from __future__ import annotations

import numpy as np
import pytest

from planopt.coverage.assignment.latch import Circumstance, is_due, relatch
from planopt.errors import InputError


def test_without_hysteresis_the_nearest() -> None:
    """Whatever was held, no hysteresis gives the nearest agents."""
    generator = np.random.default_rng(0)
    for _ in range(200):
        n = int(generator.integers(1, 12))
        # Few values, so that there are ties.
        distances = generator.integers(0, 6, n).astype(float)
        held = generator.random(n) < 0.5
        wanted = int(generator.integers(0, n + 1))
        flags = relatch(held, distances, wanted, 0.0)
        assert flags.sum() == wanted
        assert np.sort(distances[flags]).tolist() == np.sort(distances)[:wanted].tolist()


def test_hysteresis_bounds_what_is_lost() -> None:
    """Nobody who responds is more than the hysteresis farther than anybody who does not."""
    generator = np.random.default_rng(1)
    for _ in range(300):
        n = int(generator.integers(2, 15))
        distances = 10.0 * generator.random(n)
        held = generator.random(n) < 0.4
        wanted = int(generator.integers(1, n))
        margin = float(generator.choice([0.5, 2.0, 20.0]))
        flags = relatch(held, distances, wanted, margin)
        assert flags.sum() == wanted
        assert distances[flags].max() <= distances[~flags].min() + margin
        # And no more exchanges than that needs.
        swapped = int((held & ~flags).sum()) - max(int(held.sum()) - wanted, 0)
        if swapped == 0 and held.sum() == wanted:
            assert (flags == held).all()
        if margin == 20.0 and held.sum() <= wanted:
            assert flags[held].all()


def test_overtaking_changes_nothing() -> None:
    """A coverage agent that gets nearer than a sensing one by less than the margin stays away."""
    held = np.array([True, True, False])
    assert relatch(held, np.array([1.0, 5.0, 4.2]), 2, 1.0).tolist() == held.tolist()
    assert relatch(held, np.array([1.0, 5.0, 3.9]), 2, 1.0).tolist() == [True, False, True]


def test_when_it_is_due() -> None:
    """Agents, events and estimates that have moved far enough, and nothing else."""
    base = Circumstance(frozenset({1, 2}), {"a": (0.0, 0.0)})
    assert is_due(None, base, 1.0)
    assert not is_due(base, base, 0.0)
    assert not is_due(base, Circumstance(base.agents, {"a": (0.6, 0.8)}), 1.0)
    assert is_due(base, Circumstance(base.agents, {"a": (0.6, 0.9)}), 1.0)
    assert is_due(base, Circumstance(frozenset({1, 3}), base.events), 1.0)
    assert is_due(base, Circumstance(base.agents, {"b": (0.0, 0.0)}), 1.0)
    assert is_due(base, Circumstance(base.agents, {}), 1.0)


def test_bad_numbers() -> None:
    """Numbers out of range."""
    for attempt in (
        lambda: relatch(np.array([True]), np.array([1.0]), 2, 0.0),
        lambda: relatch(np.array([True]), np.array([1.0]), 1, -1.0),
        lambda: is_due(None, Circumstance(frozenset(), {}), -1.0),
    ):
        with pytest.raises(InputError):
            attempt()
