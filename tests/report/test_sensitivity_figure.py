"""The figure of Delta^2 against errors in the parameters."""

import numpy as np
import pytest
from artists import drawn, labels_of, legend_of, line_of

from planopt.errors import InputError
from planopt.report.sensitivity_figure import draw_sensitivity

ERRORS = [-0.5, 0.0, 0.5]
CURVES = {
    "n_pl": np.array([40.0, 10.0, 50.0]),
    "decorrelation_m": np.array([10.5, 10.0, 10.25]),
}


def test_curves_in_percent():
    """Each curve against per cent, named in words, units on both axes."""
    figure = drawn(draw_sensitivity(ERRORS, CURVES))
    (axes,) = figure.axes
    line = line_of(axes, "path loss exponent, n_PL")
    np.testing.assert_allclose(line.get_xydata(), [[-50.0, 40.0], [0.0, 10.0], [50.0, 50.0]])
    assert legend_of(figure) == ["path loss exponent, n_PL", "decorrelation distance, β"]
    assert labels_of(figure) == {"error in one parameter [%]", "mean squared error Δ² [dB²]"}


@pytest.mark.parametrize("curves", [{}, {"n_pl": np.array([1.0, 2.0])}])
def test_curves_that_do_not_belong(curves):
    """No curve, or one of another length."""
    with pytest.raises(InputError):
        draw_sensitivity(ERRORS, curves)
