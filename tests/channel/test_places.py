"""Checks of arguments."""

import numpy as np
import pytest

from planopt import InputError
from planopt.channel import scattered_field_db, shadow_field_db
from planopt.channel.parameters import require_count, require_finite, require_places


def test_what_is_not_is_named():
    """The key stands in the message."""
    with pytest.raises(InputError, match="at least 2"):
        require_places(np.zeros((1, 2)), 2)
    with pytest.raises(InputError, match="too far"):
        require_places(np.array([[0.0, -1e160]]))
    with pytest.raises(InputError, match="threshold_dbm"):
        require_finite(float("nan"), "threshold_dbm")
    with pytest.raises(InputError, match="count"):
        require_count(0, "count")


@pytest.mark.parametrize(
    ("std", "beta", "cell", "key"),
    [
        (-1.0, 5.0, 1.0, "shadow_std_db"),
        (np.nan, 5.0, 1.0, "shadow_std_db"),
        (4.0, 0.0, 1.0, "decorrelation_m"),
        (4.0, -5.0, 1.0, "decorrelation_m"),
        (4.0, np.inf, 1.0, "decorrelation_m"),
        (4.0, 5.0, 0.0, "cell_m"),
    ],
)
def test_what_is_no_field_is_refused(std, beta, cell, key):
    """By its name, on a lattice and at places."""
    generator = np.random.default_rng(0)
    with pytest.raises(InputError) as caught:
        shadow_field_db((4, 4), cell, std, beta, generator)
    assert caught.value.key == key
    if key != "cell_m":
        with pytest.raises(InputError) as caught:
            scattered_field_db(np.zeros((2, 2)), std, beta, generator)
        assert caught.value.key == key
