"""The figure of a channel fit."""

from dataclasses import replace

import numpy as np
import pytest
from artists import collection_of, drawn, labels_of, panel_of

from planopt.channel.measurements import Measurements
from planopt.report.fit_figure import draw_fit


@pytest.fixture(scope="module")
def figure(measurements, fit):
    """The small fit's figure, rendered."""
    return drawn(draw_fit(measurements, fit, fit.parameters.station))


def test_units(figure):
    """All axes have units."""
    assert labels_of(figure) == {
        "distance to the station d [m]",
        "power [dBm]",
        "covariance [dB²]",
        "distance between measurements [m]",
        "pairs [count]",
    }


def test_power_by_distance(figure, measurements):
    """Dots at the three-dimensional distance; the censored apart."""
    axes = panel_of(figure, "path loss")
    offset = measurements.positions_m - [50.0, 60.0]
    distance = np.sqrt((offset**2).sum(axis=1) + 25.0)
    dots = np.stack([distance, measurements.power_dbm], axis=1)
    exact = collection_of(axes, "measured").get_offsets()
    censored = collection_of(axes, "at most this (censored)").get_offsets()
    np.testing.assert_allclose(exact, dots[:25])
    np.testing.assert_allclose(censored, dots[25:])


def test_fitted_line_and_band(figure):
    """The line is K_PL - 10 n_PL log10 d over the measured distances; two deviations around it."""
    axes = panel_of(figure, "path loss")
    (line,) = axes.lines
    distance, power = line.get_xydata().T
    np.testing.assert_allclose(power, -30.0 - 25.0 * np.log10(distance))
    corners = collection_of(axes, "±2 deviations").get_paths()[0].vertices
    top = corners[np.isclose(corners[:, 0], distance[0]), 1].max()
    assert top - power[0] == pytest.approx(2.0 * np.sqrt(4.0**2 + 1.5**2))
    assert line.get_label() == "-30.0 dBm - 25.0 dB log10(d / 1 m)"


def test_covariance_against_pairs(measurements, fit):
    """Dots and bars: mean product and number of uncensored pairs, in 1 % bins of the extent."""
    figure = draw_fit(measurements, fit, fit.parameters.station)
    axes = panel_of(figure, "covariance")
    exact = measurements.positions_m[:25]
    distance = np.sqrt(((exact - [50.0, 60.0]) ** 2).sum(axis=1) + 25.0)
    residual = measurements.power_dbm[:25] - (-30.0 - 25.0 * np.log10(distance))
    first, second = np.triu_indices(25, 1)
    lag = np.linalg.norm(exact[first] - exact[second], axis=1)
    width = np.hypot(*np.ptp(exact, axis=0)) / 100.0
    expected = []
    for number in np.unique(lag // width):
        pairs = lag // width == number
        mean = (residual[first] * residual[second])[pairs].mean()
        expected.append((lag[pairs].mean(), mean, pairs.sum()))
    expected = np.array([row for row in expected if row[0] <= 5.0 * 15.0])
    dots = collection_of(axes, "mean of a bin").get_offsets()
    np.testing.assert_allclose(dots, expected[:, :2])
    heights = [bar.get_height() for bar in figure.axes[2].patches]
    np.testing.assert_array_equal(heights, expected[:, 2])


def test_fitted_covariance(figure):
    """The curve is xi^2 exp(-d / beta); at no distance multipath adds its variance."""
    curve, origin = panel_of(figure, "covariance").lines
    lag, covariance = curve.get_xydata().T
    np.testing.assert_allclose(covariance, 16.0 * np.exp(-lag / 15.0))
    np.testing.assert_allclose(origin.get_xydata(), [[0.0, 18.25]])


def test_errors_where_known(figure):
    """Standard errors stand in the legend, an unknown one is left out."""
    texts = [text.get_text() for text in panel_of(figure, "covariance").get_legend().get_texts()]
    assert "fit: deviation 4 ± 0.5 dB, decorrelation 15 ± 3 m" in texts
    assert "with multipath, deviation 1.5 dB" in texts


@pytest.mark.parametrize("count", [1, 2])
def test_hardly_any_measurements(fit, count):
    """One place, or one measured and one censored, is drawn without residuals."""
    few = Measurements(
        10.0 * np.arange(2.0 * count).reshape(count, 2), np.full(count, -60.0), np.arange(count) > 0
    )
    figure = drawn(draw_fit(few, replace(fit, measurements=count), fit.parameters.station))
    assert not figure.axes[2].patches
