"""Measurements refuse what does not fit, and join in order."""

import numpy as np
import pytest

from planopt.channel.measurements import Measurements, join
from planopt.errors import InputError


def some(count, start=0.0):
    """Numbered measurements."""
    values = start + np.arange(count, dtype=float)
    return Measurements(np.column_stack([values, values]), values, values % 2 == 1)


@pytest.mark.parametrize(
    ("positions", "power", "censored"),
    [((3, 2), 2, 2), ((2, 3), 2, 2), ((2, 2), 2, 3), ((2,), 2, 2)],
)
def test_shapes_must_agree(positions, power, censored):
    """A mismatch is our error, with the shapes in it."""
    with pytest.raises(InputError, match="do not belong together"):
        Measurements(np.zeros(positions), np.zeros(power), np.zeros(censored, dtype=bool))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_must_be_finite(bad):
    """Neither a power nor a coordinate may be NaN or infinite."""
    with pytest.raises(InputError, match="not finite"):
        Measurements(np.zeros((1, 2)), np.array([bad]), np.array([False]))
    with pytest.raises(InputError, match="not finite"):
        Measurements(np.array([[0.0, bad]]), np.zeros(1), np.array([False]))


def test_join_keeps_order_and_flags():
    """First before second, everything together."""
    joined = join(some(3), some(2, start=10.0))
    assert len(joined) == 5
    np.testing.assert_array_equal(joined.power_dbm, [0.0, 1.0, 2.0, 10.0, 11.0])
    np.testing.assert_array_equal(joined.positions_m[:, 1], joined.power_dbm)
    np.testing.assert_array_equal(joined.censored, [False, True, False, False, True])


def test_none_is_a_number_too():
    """Empty sets are valid and neutral."""
    assert len(some(0)) == 0
    assert len(join(some(0), some(2))) == 2
