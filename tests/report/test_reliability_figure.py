"""The reliability diagram."""

import numpy as np
import pytest
from artists import drawn, labels_of, legend_of, line_of, panel_of

from planopt.channel.calibration import reliability
from planopt.errors import InputError
from planopt.report.reliability_figure import draw_reliability


def table(optimism: float):
    """Tables of eight runs of 50 steps, predicted `optimism` too high."""
    generator = np.random.default_rng(1)
    predicted = generator.uniform(0.6, 1.0, 400)
    realised = generator.uniform(size=400) < predicted - optimism
    return reliability(predicted, realised, np.arange(400) % 8)


def test_points():
    """Percent against percent, the difference below in points, all axes with units."""
    right, high = table(0.0), table(0.2)
    figure = drawn(draw_reliability({"right": right, "too high": high}, "two"))
    line = line_of(panel_of(figure, "reliability"), "too high").get_xydata()
    np.testing.assert_allclose(line, [[100 * b.predicted, 100 * b.realised] for b in high])
    apart = [
        one.get_ydata()
        for one in panel_of(figure, "less predicted").lines
        if len(one.get_ydata()) == len(high)
    ]
    expected = [100 * (b.realised - b.predicted) for b in high]
    assert any(np.allclose(np.asarray(y, dtype=float), expected) for y in apart)
    assert {"right", "too high", "as predicted"} <= set(legend_of(figure))
    assert labels_of(figure) == {
        "predicted P(connected) [%]",
        "truly connected [%]",
        "bin of predicted P(connected) [%]",
        "difference [percentage points]",
    }


def test_none():
    """Nothing to draw."""
    with pytest.raises(InputError):
        draw_reliability({"nothing": ()}, "none")
