"""The figure of estimated against true positions."""

import numpy as np
import pytest
from artists import drawn, labels_of, legend_of

from planopt.errors import InputError
from planopt.report.station_figure import draw_stations

TRUE = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
NEAR = TRUE + [3.0, 4.0]
FAR = TRUE + np.array([[6.0, 8.0], [0.0, 20.0], [30.0, 0.0], [0.0, 40.0]])
MEASURED = np.array([[5.0, 5.0], [6.0, 5.0]])


def test_lines_from_true_to_estimated():
    """On the map each true position is joined to the first method's estimate, and no other."""
    figure = drawn(draw_stations(TRUE, {"near": NEAR, "far": FAR}, MEASURED))
    scene, _ = figure.axes
    joined = next(line for line in scene.get_lines() if len(line.get_xdata()) == 12)
    ends = np.asarray(joined.get_xydata()).reshape(4, 3, 2)
    np.testing.assert_array_equal(ends[:, 0], TRUE)
    np.testing.assert_array_equal(ends[:, 1], NEAR)
    assert np.isnan(ends[:, 2]).all()
    assert legend_of(figure) == ["true", "estimated", "measured here"]


def test_distribution_of_errors():
    """Steps up by one transmitter at each error, from none to all; median and 90 % in words."""
    figure = drawn(draw_stations(TRUE, {"near": NEAR, "far": FAR}, MEASURED))
    _, errors = figure.axes
    near, far = errors.get_lines()
    np.testing.assert_allclose(near.get_xdata(), 5.0)
    np.testing.assert_allclose(far.get_xdata(), [10, 10, 20, 20, 30, 30, 40, 40])
    np.testing.assert_allclose(far.get_ydata(), [0, 25, 25, 50, 50, 75, 75, 100])
    assert near.get_label() == "near: median 5.00 m, 90 % 5.00 m"
    assert far.get_label() == "far: median 25.00 m, 90 % 37.00 m"
    assert {"x [m]", "y [m]", "distance to the true position [m]"} < labels_of(figure)


@pytest.mark.parametrize("estimates", [{}, {"short": NEAR[:2]}])
def test_estimates_that_do_not_belong(estimates):
    """None, or not one for each."""
    with pytest.raises(InputError, match="one estimate for each of 4"):
        draw_stations(TRUE, estimates, MEASURED)
