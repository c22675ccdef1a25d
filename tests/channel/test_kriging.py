"""What cannot be predicted at is refused, with and without a factor."""

import numpy as np
import pytest

from planopt import InputError
from planopt.channel import ChannelParameters, Measurements, Station, condition

CHANNEL = ChannelParameters(-30.0, 2.5, 4.0, 20.0, 2.0, Station((0.0, 0.0)))
MEASURED = Measurements(
    np.array([[10.0, 0.0], [0.0, 30.0], [50.0, 5.0]]), np.full(3, -70.0), np.zeros(3, bool)
)


@pytest.mark.parametrize("exact_limit", [3, 2])
@pytest.mark.parametrize("places", [np.zeros(2), np.zeros((2, 3)), [[np.nan, 0.0]], [[1e160, 0.0]]])
def test_no_such_places(places, exact_limit):
    """Neither NaN nor an error of NumPy's comes of them."""
    posterior = condition(CHANNEL, MEASURED, exact_limit=exact_limit)
    with pytest.raises(InputError, match="positions_m"):
        posterior.predict(np.asarray(places))
    with pytest.raises(InputError, match="positions_m"):
        posterior.connectivity(np.asarray(places), -80.0)


def test_no_places_and_no_threshold():
    """Nowhere is fine, a threshold of NaN is not."""
    posterior = condition(CHANNEL, MEASURED)
    assert posterior.predict(np.zeros((0, 2))).mean_db.shape == (0,)
    with pytest.raises(InputError, match="threshold_dbm"):
        posterior.connectivity(np.array([[1.0, 2.0]]), float("nan"))
