"""The triptych of a belief."""

from dataclasses import replace

import numpy as np
from artists import collection_of, drawn, labels_of, legend_of, panel_of

from planopt.channel.measurements import Measurements
from planopt.channel.posterior import condition
from planopt.report.map_figure import draw_belief


def test_three_maps_with_units(problem, belief):
    """Power, deviation and probability, each with its unit; the legend under the maps."""
    figure = drawn(draw_belief(problem, belief))
    assert labels_of(figure) == {
        "x [m]",
        "y [m]",
        "power [dBm] (line: threshold)",
        "deviation [dB]",
        "P(connected) [1] (line: p_min)",
    }
    assert legend_of(figure) == [
        "start",
        "goal",
        "station",
        "measured",
        "measured at the floor (censored)",
        "p_min = 0.8",
    ]


def test_maps_are_the_prediction(problem, belief):
    """Values in the three images at a free place equal the posterior's there."""
    figure = draw_belief(problem, belief)
    images = [
        panel_of(figure, title).images[0]
        for title in ("predicted power", "deviation of", "P(power ≥ -72 dBm)")
    ]
    left, right, bottom, top = images[0].get_extent()
    rows, columns = images[0].get_array().shape
    row, column = rows // 8, columns // 8
    place = np.array(
        [
            [
                left + (column + 0.5) * (right - left) / columns,
                bottom + (row + 0.5) * (top - bottom) / rows,
            ]
        ]
    )
    prediction = belief.posterior.predict(place)
    chance = belief.posterior.connectivity(place, -72.0)
    shown = [image.get_array()[row, column] for image in images]
    expected = [prediction.mean_db[0], prediction.deviation_db[0], chance[0]]
    np.testing.assert_allclose(shown, expected, rtol=1e-9)


def test_measurements_are_dots(problem, belief, measurements):
    """Uncensored filled, censored hollow, at their places."""
    axes = panel_of(draw_belief(problem, belief), "predicted power")
    filled = collection_of(axes, "measured")
    hollow = collection_of(axes, "measured at the floor (censored)")
    np.testing.assert_array_equal(filled.get_offsets(), measurements.positions_m[:25])
    np.testing.assert_array_equal(hollow.get_offsets(), measurements.positions_m[25:])
    assert len(filled.get_facecolors()) == 1 and len(hollow.get_facecolors()) == 0


def test_no_measurements(problem, belief):
    """A belief from nothing is drawn, without dots."""
    nothing = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
    posterior = condition(belief.fit.parameters, nothing)
    figure = drawn(draw_belief(problem, replace(belief, posterior=posterior)))
    assert "measured" not in legend_of(figure)
