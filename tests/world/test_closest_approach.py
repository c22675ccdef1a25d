"""The closed form against places sampled densely, and against what is known without it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planopt.world.motion import closest_approach_m, nearest_to_origin_m

SHARES = np.linspace(0.0, 1.0, 20_001)[:, None]
PLACE = st.tuples(*[st.floats(-1e3, 1e3, width=32)] * 2).map(np.array)


@given(PLACE, PLACE, PLACE, PLACE)
def test_never_above_any_sample_and_met_by_one(a0, a1, b0, b1):
    """Between samples the distance changes by no more than the relative motion does."""
    found = float(closest_approach_m(a0, a1, b0, b1))
    apart = (1.0 - SHARES) * (a0 - b0) + SHARES * (a1 - b1)
    sampled = float(np.hypot(*apart.T).min())
    between = float(np.hypot(*((a1 - b1) - (a0 - b0)))) / 20_000
    assert found <= sampled + 1e-9
    assert found >= sampled - between - 1e-9


def test_equal_times_are_what_counts():
    """Ways that cross are no meeting where one passes later; a chase keeps its distance."""
    cross = closest_approach_m(*map(np.array, ([0.0, 0], [10.0, 0], [5.0, -5], [5.0, 5])))
    assert cross == pytest.approx(0.0, abs=1e-12)
    later = closest_approach_m(*map(np.array, ([0.0, 0], [10.0, 0], [9.0, -9], [9.0, 1])))
    assert later == pytest.approx(0.0, abs=1e-9)
    chase = closest_approach_m(*map(np.array, ([0.0, 0], [4.0, 0], [-3.0, 0], [1.0, 0])))
    assert chase == 3.0
    swap = closest_approach_m(*map(np.array, ([0.0, 0], [4.0, 0], [4.0, 0], [0.0, 0])))
    assert swap == pytest.approx(0.0, abs=1e-12)


@given(PLACE, PLACE, PLACE, PLACE)
def test_symmetry(a0, a1, b0, b1):
    """The same seen from the other, backwards in time, and in a mirror."""
    found = closest_approach_m(a0, a1, b0, b1)
    mirror = np.array([-1.0, 1.0])
    for other in (
        closest_approach_m(b0, b1, a0, a1),
        closest_approach_m(a1, a0, b1, b0),
        closest_approach_m(mirror * a0, mirror * a1, mirror * b0, mirror * b1),
    ):
        assert other == pytest.approx(float(found), abs=1e-6)


def test_ends_come_out_exactly_and_not_a_number_stays_one():
    """A way that leads away is nearest where it begins, to the last digit."""
    begin, end = np.array([0.1, 0.7]), np.array([7.3, 11.9])
    assert (nearest_to_origin_m(begin, end) == begin).all()
    assert (nearest_to_origin_m(end, begin) == begin).all()
    assert (nearest_to_origin_m(begin, begin) == begin).all()
    bad = np.array([np.nan, 0.0])
    assert np.isnan(closest_approach_m(bad, end, begin, begin))
