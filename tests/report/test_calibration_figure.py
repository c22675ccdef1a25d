"""The calibration plot."""

from dataclasses import replace

import numpy as np
import pytest
from artists import drawn, labels_of, legend_of, line_of, panel_of

from planopt.channel.calibration import calibrate
from planopt.channel.measurements import Measurements
from planopt.channel.prediction import Prediction
from planopt.errors import InputError
from planopt.report.calibration_figure import draw_calibration


@pytest.fixture
def calibrations():
    """One prediction that is right, one that is too sure."""
    power = np.random.default_rng(0).normal(0.0, 2.0, 200)
    data = Measurements(np.zeros((200, 2)), power, np.arange(200) < 10)
    return {
        name: calibrate(Prediction(np.zeros(200), np.full(200, deviation)), data)
        for name, deviation in (("right", 2.0), ("sure", 1.0))
    }


def test_curves(calibrations):
    """Coverage in percent against level, the PIT as steps, all axes with units."""
    figure = drawn(draw_calibration(calibrations))
    sure = calibrations["sure"]
    label = f"sure: rmse {sure.rmse_db:.2f} dB"
    line = line_of(panel_of(figure, "coverage"), label)
    expected = [[100.0 * one.level, 100.0 * one.share] for one in sure.coverage]
    np.testing.assert_allclose(line.get_xydata(), expected)
    steps = line_of(panel_of(figure, "integral"), "sure").get_xydata()
    np.testing.assert_allclose(steps[::2, 1], 100.0 * sure.pit_share)
    np.testing.assert_allclose(steps[1::2, 0], sure.pit_edges[1:])
    assert label in legend_of(figure)
    assert labels_of(figure) == {
        "level of the interval [%]",
        "measurements inside [%]",
        "predicted probability of less than measured [1]",
        "measurements [%]",
    }


def test_none():
    """Nothing to draw."""
    with pytest.raises(InputError):
        draw_calibration({})


def test_an_end_that_passes_its_share_by_rounding(calibrations):
    """A share whose interval ends there is drawn with no bar on that side."""
    right = calibrations["right"]
    past = replace(right.coverage[0], share=1.0, low=1.0 + 1e-15, high=1.0 - 1e-15)
    drawn(draw_calibration({"past": replace(right, coverage=(past,))}))
