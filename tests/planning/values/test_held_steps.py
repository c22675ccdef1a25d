"""The fewest steps to hold, against all subsets."""

import numpy as np

from planopt.planning.plan import History
from planopt.planning.proof.connectivity_rules import Outage


def fewest_held(sizes, keeps, limit, before):
    """What the rule holds after an outage of so many metres."""
    return Outage(0.9, sizes, limit).held(keeps, History(outage_m=before))


def test_fewest_held_leaves_no_run_too_long():
    """Against all subsets of five steps, where enough steps can be held for nothing."""
    generator = np.random.default_rng(2)
    for _ in range(20):
        sizes = generator.uniform(0.5, 2.0, 5)
        before, limit = generator.uniform(0.0, 2.0), generator.uniform(2.0, 5.0)
        held = fewest_held(sizes, np.ones(5, dtype=bool), limit, before)
        fewest = min(
            bin(mask).count("1")
            for mask in range(32)
            if _keeps(sizes, np.array([bool(mask >> k & 1) for k in range(5)]), limit, before)
        )
        assert _keeps(sizes, held, limit, before)
        assert held.sum() == fewest


def _keeps(sizes, held, limit, before):
    run = before
    for size, is_held in zip(sizes, held, strict=True):
        run = 0.0 if is_held else run + size
        if run > limit and not is_held:
            return False
    return True
