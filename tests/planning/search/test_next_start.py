"""Which starts are polished besides the best."""

from __future__ import annotations

import numpy as np
import pytest

from planopt.planning.horizon_planner import CLOSE_SHARE, MERGED_STEPS, is_worth_following
from planopt.planning.search.guess_search import Guess

PATH = np.zeros((4, 2))


def start(worth, offset=0.0):
    """A start beside `PATH`."""
    return Guess(PATH + offset, worth, 0.0)


@pytest.mark.parametrize("best", [3.0, -3.0])
def test_only_starts_that_are_nearly_as_good(best):
    """Whatever the sign of the worth."""
    near, far = best - 0.9 * CLOSE_SHARE * 3.0, best - 1.1 * CLOSE_SHARE * 3.0
    assert is_worth_following(start(near, 50.0), start(best), [PATH], 2.0)
    assert not is_worth_following(start(far, 50.0), start(best), [PATH], 2.0)


def test_only_starts_that_lead_elsewhere():
    """Apart from every polished path."""
    beside, away = 0.9 * MERGED_STEPS * 2.0, 1.1 * MERGED_STEPS * 2.0
    assert not is_worth_following(start(1.0, beside), start(1.0), [PATH], 2.0)
    assert is_worth_following(start(1.0, away), start(1.0), [PATH], 2.0)
    assert not is_worth_following(start(1.0, away), start(1.0), [PATH, PATH + away], 2.0)
