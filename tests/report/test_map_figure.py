"""The figure of a map shows the three rasters, the measurements and the station."""

from dataclasses import replace

import numpy as np
import pytest
from artists import drawn, labels_of, legend_of, panel_of

from planopt.channel.channel_map import posterior_map
from planopt.channel.parameters import Station
from planopt.channel.posterior import condition
from planopt.report.map_figure import draw_posterior_map


@pytest.fixture(scope="module")
def maps(fit, measurements):
    """Ten by eight cells, narrower than what was measured."""
    return posterior_map(condition(fit.parameters, measurements), (0, 0, 70, 56), 7.0, -72.0)


def test_three_maps(maps, fit, measurements):
    """Each raster with its unit in its panel, cut at the cells' edges."""
    figure = drawn(draw_posterior_map(maps, measurements, fit.parameters.station, "a log"))
    assert labels_of(figure) == {
        "x [m]",
        "y [m]",
        "power [dBm] (line: threshold)",
        "deviation [dB]",
        "P(connected) [1]",
    }
    for title, raster in (
        ("predicted power", maps.mean_db),
        ("deviation", maps.deviation_db),
        ("P(power ≥ -72 dBm)", maps.connectivity),
    ):
        axes = panel_of(figure, title)
        np.testing.assert_array_equal(axes.images[0].get_array(), raster.values)
        assert axes.get_xlim() == (0, 70) and axes.get_ylim() == (0, 56)
    assert figure.get_suptitle() == "a log"


def test_measurements_and_station(maps, fit, measurements):
    """Both kinds of measurements on the deviation; the station only where it is on the map."""
    figure = drawn(draw_posterior_map(maps, measurements, Station((35.0, 20.0)), ""))
    drawn_dots = [
        np.asarray(dots.get_offsets()) for dots in panel_of(figure, "deviation").collections
    ]
    for selection in (slice(25), slice(25, None)):
        positions = measurements.positions_m[selection]
        assert any(np.array_equal(dots, positions) for dots in drawn_dots)
    floor = "measured at the floor (censored)"
    assert legend_of(figure) == ["measured", floor, "station"]
    exact = replace(measurements, censored=np.zeros(30, dtype=bool))
    away = drawn(draw_posterior_map(maps, exact, Station((35.0, 60.0)), ""))
    assert legend_of(away) == ["measured"]
