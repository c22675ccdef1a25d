"""Predictions on a grid against those at its places."""

import numpy as np
import pytest

from planopt.channel.maps.many_places import INVERT_BELOW, PLACES_AT_ONCE, RowWhitener
from planopt.channel.maps.posterior_map import predict_grid
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import EXACT_LIMIT, at_time, condition

PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0), 400.0)


def measured(count):
    """Random measurements with everything they may have."""
    generator = np.random.default_rng(1)
    return Measurements(
        generator.uniform(-100.0, 100.0, (count, 2)),
        generator.normal(-90.0, 6.0, count),
        generator.random(count) < 0.1,
        position_std_m=generator.uniform(0.0, 4.0, count),
        time_s=generator.uniform(0.0, 100.0, count),
        receiver=generator.integers(0, 2, count),
    )


@pytest.mark.parametrize("limit", [EXACT_LIMIT, 0])
@pytest.mark.parametrize(
    ("shape", "count"),
    [
        ((31, 33), 20),
        ((40, 50), 0),
        ((40, 50), 60),
        ((3, 2 * PLACES_AT_ONCE + 7), 60),
        ((PLACES_AT_ONCE + 9, 3), 60),
        ((60, 40), INVERT_BELOW + 5),
    ],
)
def test_grid_equals_its_places(shape, count, limit):
    """Few and many places and measurements, wide and narrow grids, with and without a factor."""
    posterior = at_time(condition(PARAMETERS, measured(count), exact_limit=limit), 150.0)
    y, x = (np.linspace(-120.0, 110.0, size) for size in shape)
    found = predict_grid(posterior, x, y)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    few = [posterior.predict(part) for part in np.array_split(places, 8)]
    # Without a factor the groups of places differ, and so do the neighbours they share.
    tolerance = 1e-10 if limit else 1e-2
    for name in ("mean_db", "deviation_db"):
        expected = np.concatenate([getattr(one, name) for one in few]).reshape(shape)
        np.testing.assert_allclose(getattr(found, name), expected, atol=tolerance, rtol=0.0)


@pytest.mark.parametrize("count", [1, INVERT_BELOW - 1, INVERT_BELOW])
def test_rows_are_reduced(count):
    """What rows tell of columns and variance, by dense solves, with and without the inverse."""
    generator = np.random.default_rng(0)
    root = generator.standard_normal((count, count))
    lower = np.linalg.cholesky(root @ root.T / count + np.eye(count))
    columns, rows = generator.standard_normal((count, 3)), generator.standard_normal((7, count))
    whitened = np.linalg.solve(lower, rows.T)
    projected, explained = RowWhitener(lower, columns).reduce(rows.copy())
    np.testing.assert_allclose(projected, columns.T @ whitened, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(explained, (whitened**2).sum(axis=0), rtol=1e-10)
