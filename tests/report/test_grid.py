"""The prediction grid: where its cells are, and which are predicted."""

from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from planopt.report.grid import NODES, cell_centres, drawn_cells, predicted_rasters


def test_cells_fill_the_bounds():
    """Square cells, the chosen number along the long side, half a cell inside the bounds."""
    x, y = cell_centres((-10.0, 5.0, 290.0, 105.0))
    assert len(x) == NODES and len(y) == NODES // 3
    assert x[0] == pytest.approx(-9.0) and x[-1] == pytest.approx(289.0)
    assert y[0] == pytest.approx(6.0) and y[-1] == pytest.approx(104.0)


def test_thin_bounds_have_two_cells():
    """A raster needs at least two cells along both axes."""
    x, y = cell_centres((0.0, 0.0, 1000.0, 0.1))
    assert (len(x), len(y)) == (NODES, 2)


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
    mean, deviation = predicted_rasters(
        belief.posterior, problem.workspace, (0.0, 0.0, 100.0, 80.0)
    )
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


def test_one_prediction_call(problem):
    """All places go to the posterior at once."""
    calls = []

    def predict(places):
        calls.append(len(places))
        return SimpleNamespace(mean_db=np.zeros(len(places)), deviation_db=np.ones(len(places)))

    mean, _ = predicted_rasters(
        SimpleNamespace(predict=predict), problem.workspace, (0.0, 0.0, 100.0, 80.0)
    )
    assert calls == [int(np.isfinite(mean.values).sum())]
