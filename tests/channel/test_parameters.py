"""Parameters and stations refuse what no channel has."""

import math
from dataclasses import replace

import pytest

from planopt import InputError
from planopt.channel import ChannelParameters, Station

CHANNEL = ChannelParameters(-30.0, 2.5, 4.0, 20.0, 2.0, Station((0.0, 0.0)))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("k_pl_db", math.nan),
        ("n_pl", math.inf),
        ("shadow_std_db", -1.0),
        ("shadow_std_db", math.nan),
        ("decorrelation_m", 0.0),
        ("decorrelation_m", math.inf),
        ("multipath_std_db", -1.0),
        ("forgetting_s", 0.0),
        ("forgetting_s", math.nan),
    ],
)
def test_no_such_channel(name, value):
    """The error names the parameter."""
    with pytest.raises(InputError) as caught:
        replace(CHANNEL, **{name: value})
    assert caught.value.key == name


def test_what_may_be_zero_or_endless():
    """No shadowing, no multipath, no drift, and power that rises with distance."""
    still = ChannelParameters(0.0, -1.0, 0.0, 1.0, 0.0, Station((0.0, 0.0), -2.0))
    assert math.isinf(still.forgetting_s)


@pytest.mark.parametrize(
    ("position_m", "height_m"),
    [((math.nan, 0.0), 0.0), ((0.0, math.inf), 0.0), ((0.0, 0.0), math.nan), ((1e160, 0.0), 0.0)],
)
def test_no_such_place(position_m, height_m):
    """A station is somewhere."""
    with pytest.raises(InputError, match="no coordinate of a station"):
        Station(position_m, height_m)
