"""Maps: the prediction grid, outlines, rasters, contours, places, the shown window."""

import numpy as np
import pytest
import shapely
from artists import drawn
from scenes import small_problem

from planopt.report.maps import (
    BORDER,
    believed_rasters,
    draw_ground,
    draw_layer,
    draw_level,
    drawn_cells,
    joined,
    outline,
    window_about,
)
from planopt.report.panel import new_figure
from planopt.world import Raster


@pytest.fixture
def sheet():
    return new_figure(4.0, 4.0, maps_only=True)


@pytest.fixture
def figure(sheet):
    return sheet[0]


@pytest.fixture
def panel(sheet):
    return sheet[1][0]


@pytest.mark.parametrize("turned", [False, True])
def test_outline_keeps_holes_open(turned):
    """Rings have opposite orientations whatever the polygon's, so that the hole is empty."""
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
    draw_level(panel, Raster(np.arange(2.0), np.arange(3.0), values), level, "level")
    assert bool(panel.collections) is crossed


def test_drawn_cells_against_shapely(problem):
    """Cells with a free cell among themselves and their eight neighbours, by brute force."""
    x, y = np.linspace(-15.0, 115.0, 40), np.linspace(-15.0, 95.0, 30)
    area = shapely.box(*problem.workspace.bounds_m).difference(
        shapely.union_all([obstacle.polygon for obstacle in problem.workspace.obstacles])
    )
    free = np.array([[area.contains(shapely.Point(a, b)) for a in x] for b in y])
    expected = np.zeros_like(free)
    for row, column in np.argwhere(free):
        expected[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = True
    drawn = drawn_cells(problem.workspace, x, y)
    np.testing.assert_array_equal(drawn, expected)
    assert not drawn.all()


def test_rasters_are_the_posterior(problem, belief):
    """Each cell has what the posterior predicts at its centre, the courtyard included."""
    mean, deviation, _ = believed_rasters(problem, belief, (0.0, 0.0, 100.0, 80.0))
    iy, ix = np.argwhere(np.isfinite(mean.values))[::997].T
    expected = belief.posterior.predict(np.stack([mean.x_m[ix], mean.y_m[iy]], axis=1))
    np.testing.assert_allclose(mean.values[iy, ix], expected.mean_db, rtol=1e-9)
    np.testing.assert_allclose(deviation.values[iy, ix], expected.deviation_db, rtol=1e-9)
    np.testing.assert_array_equal(np.isfinite(mean.values), np.isfinite(deviation.values))

    def at(raster, place):
        return raster.values[
            np.abs(raster.y_m - place[1]).argmin(), np.abs(raster.x_m - place[0]).argmin()
        ]

    assert np.isfinite(at(mean, (50.0, 30.0)))  # courtyard
    assert np.isnan(at(mean, (42.5, 30.0)))  # wing


@pytest.mark.parametrize("seed", range(5))
def test_places_are_shown_and_little_outside_the_workspace(seed: int) -> None:
    generator = np.random.default_rng(seed)
    problem = small_problem(bounds_m=(-50.0, 0.0, 70.0, 120.0))
    for _ in range(20):
        places = generator.uniform((-50.0, 0.0), (70.0, 120.0), (4, 2))
        x_min, y_min, x_max, y_max = window_about(problem, places)
        side = x_max - x_min
        assert side == pytest.approx(y_max - y_min)
        assert (places > (x_min, y_min)).all() and (places < (x_max, y_max)).all()
        low, high = BORDER * side, 120.0 + BORDER * side
        if side <= high + low:
            edge = 1e-9
            assert min(x_min + 50.0, y_min) >= -low - edge
            assert max(x_max + 50.0, y_max) <= high + edge


def test_what_is_shown_beyond_the_bounds() -> None:
    """A station outside stays in sight; neighbouring tiles of a grid are one outline."""
    problem = small_problem(bounds_m=(0.0, 0.0, 40.0, 30.0))
    places = np.array([[5.0, 5.0], [90.0, 10.0]])
    x_min, y_min, x_max, y_max = window_about(problem, places)
    assert x_min < 5.0 and x_max > 90.0 and y_min < 5.0 and y_max > 10.0
    # Nothing else is shown beyond the bounds
    assert -10.0 < x_min and -10.0 < y_min and y_max < 40.0 and x_max < 100.0
    tiles = [shapely.box(x, 0, x + 2, 2) for x in (0, 2, 4)]
    house = shapely.box(10, 0, 11, 1)
    found = joined([*tiles, house])
    assert sorted(each.area for each in found) == [1.0, 12.0]
    assert joined([]) == []
