"""Map layers: outlines, rasters, contours, places."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from artists import drawn
from matplotlib.gridspec import GridSpec

from planopt.report.maps import draw_ground, draw_layer, draw_level, draw_places, outline
from planopt.report.panel import add_panel, new_figure
from planopt.world.raster import Raster


@pytest.fixture
def figure():
    """An empty figure."""
    return new_figure(4.0, 4.0, maps_only=True)


@pytest.fixture
def panel(figure):
    """Its only panel."""
    return add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])


@pytest.mark.parametrize("turned", [False, True])
def test_outline_keeps_holes_open(turned):
    """Rings turn opposite ways whichever way the polygon gives them, so that the hole is empty."""
    hole = [(4, 4), (6, 4), (6, 6), (4, 6)]
    path = outline(
        shapely.Polygon([(0, 0), (10, 0), (10, 10), (0, 10)], [hole[::-1] if turned else hole])
    )
    rings = path.to_polygons()
    areas = [shapely.LinearRing(ring).is_ccw for ring in rings]
    assert len(rings) == 2 and areas[0] != areas[1]
    assert path.contains_point((2.0, 2.0)) and not path.contains_point((12.0, 2.0))


def test_hole_is_blank_when_rendered(figure, panel, problem):
    """The courtyard's pixel is background, the wing's is not."""
    draw_ground(panel, problem.workspace, "map")
    drawn(figure)
    pixels = np.asarray(figure.canvas.buffer_rgba())

    def colour(place):
        column, row = panel.transData.transform(place)
        return tuple(pixels[len(pixels) - 1 - round(row), round(column)][:3])

    assert colour((50.0, 30.0)) == (255, 255, 255)
    assert colour((42.5, 30.0)) != (255, 255, 255)


def test_ground_has_metres_and_equal_scale(panel, problem):
    """Labels with units, equal aspect, the workspace in view, one path per obstacle."""
    draw_ground(panel, problem.workspace, "map")
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("x [m]", "y [m]")
    assert panel.get_aspect() == 1.0
    assert (*panel.get_xlim(), *panel.get_ylim()) == (0.0, 100.0, 0.0, 80.0)
    assert len(panel.collections[0].get_paths()) == 2


def test_ground_without_obstacles(figure, panel, problem):
    """An empty workspace is drawn without complaint."""
    draw_ground(panel, replace(problem.workspace, obstacles=()), "map")
    drawn(figure)


def test_layer_is_the_raster_in_place(figure, panel):
    """Row 0 is at the smallest y; the extent reaches half a cell beyond the centres."""
    raster = Raster(np.array([0.0, 2.0, 4.0]), np.array([10.0, 11.0]), np.arange(6.0).reshape(2, 3))
    draw_layer(panel, raster, "viridis", figure, "power [dBm]", (-1.0, 7.0), mark=3.0)
    (image,) = panel.images
    np.testing.assert_array_equal(image.get_array(), raster.values)
    assert image.origin == "lower"
    assert tuple(image.get_extent()) == (-1.0, 5.0, 9.5, 11.5)
    assert image.get_clim() == (-1.0, 7.0)
    bar = figure.axes[-1]
    assert bar.get_ylabel() == "power [dBm]"
    assert [line.get_ydata()[0] for line in bar.lines] == [3.0, 3.0]


@pytest.mark.parametrize(("level", "crossed"), [(0.5, True), (1.5, False), (0.0, False)])
def test_level_only_where_crossed(panel, level, crossed):
    """A level outside the values draws nothing, and does not warn."""
    values = np.array([[0.0, 1.0], [0.0, np.nan], [0.0, 1.0]])
    draw_level(panel, Raster(np.arange(2.0), np.arange(3.0), values), level, "black")
    assert bool(panel.collections) is crossed


def test_level_of_nothing(panel):
    """A raster without values has no contour."""
    raster = Raster(np.arange(2.0), np.arange(2.0), np.full((2, 2), np.nan))
    draw_level(panel, raster, 0.5, "black")
    assert not panel.collections


def test_places(panel, problem):
    """Start, goal and station are where the problem has them."""
    start, goal, station = draw_places(panel, problem)
    np.testing.assert_array_equal(start.get_offsets(), [[10.0, 10.0]])
    np.testing.assert_array_equal(goal.get_offsets(), [[90.0, 75.0]])
    np.testing.assert_array_equal(station.get_offsets(), [[50.0, 60.0]])
    assert [part.get_label() for part in (start, goal, station)] == ["start", "goal", "station"]
