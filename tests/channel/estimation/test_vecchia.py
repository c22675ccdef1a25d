"""Products of whitened columns against dense inverses."""

import numpy as np
import pytest

from planopt.channel.estimation.vecchia import (
    added_products,
    nearest_earlier,
    whitened_products,
)
from planopt.channel.measurement_covariance import Origins, own_covariance_db2
from planopt.channel.nearest.place_index import PlaceIndex
from planopt.channel.nearest.windows import BESIDE, BLOCK
from planopt.channel.parameters import ChannelParameters, Station

PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))


def scene(count, seed=0):
    """Origins, noise and columns of random measurements."""
    generator = np.random.default_rng(seed)
    origins = Origins(generator.uniform(-100.0, 100.0, (count, 2)))
    return origins, generator.uniform(1.0, 9.0, count), generator.standard_normal((count, 3))


def dense(origins, noise, columns):
    """C' U^-1 C."""
    covariance = own_covariance_db2(origins, PARAMETERS) + np.diag(noise)
    return columns.T @ np.linalg.solve(covariance, columns)


@pytest.mark.parametrize("count", [0, 1, BLOCK + 1, BESIDE + 20])
def test_with_all_earlier_ones_it_is_exact(count):
    """Nothing is left out while there are no more than `BESIDE` before any block."""
    given = scene(count)
    np.testing.assert_allclose(
        whitened_products(PARAMETERS, *given), dense(*given), rtol=1e-10, atol=1e-10
    )


def test_close_to_exact_for_many():
    """Products of 1,200 within 1 % of those of the factor of all."""
    given = scene(1200)
    found, expected = whitened_products(PARAMETERS, *given), dense(*given)
    scale = np.sqrt(np.diag(expected))
    assert 0.0 < np.abs((found - expected) / np.outer(scale, scale)).max() < 0.01


@pytest.mark.parametrize("cut", [0, 1, 100, 649])
def test_rows_add_up(cut):
    """In the order given, the last rows add what the first ones lack of all."""
    origins, noise, columns = scene(650)
    head = slice(cut)
    first = added_products(PARAMETERS, origins.at(head), noise[head], columns[head], 0)
    rest = added_products(PARAMETERS, origins, noise, columns, cut)
    whole = added_products(PARAMETERS, origins, noise, columns, 0)
    np.testing.assert_allclose(first + rest, whole, rtol=1e-11)


def test_the_order_of_a_batch_does_not_matter():
    """Products depend on the places, not on the order of the rows."""
    origins, noise, columns = scene(300)
    order = np.random.default_rng(1).permutation(300)
    np.testing.assert_allclose(
        whitened_products(PARAMETERS, origins.at(order), noise[order], columns[order]),
        whitened_products(PARAMETERS, origins, noise, columns),
        rtol=1e-9,
    )


def test_blocks_serve_a_path_better():
    """Of a path of dense rows the information of theta is nearer to exact than in its order."""
    generator = np.random.default_rng(4)
    along, row = np.arange(1500) % 50, np.arange(1500) // 50
    along = np.where(row % 2, 49 - along, along)
    places = np.column_stack([along, 2.0 * row]) + generator.normal(0.0, 0.1, (1500, 2))
    columns = np.column_stack([np.ones(1500), np.hypot(*places.T)])
    given = Origins(places), np.full(1500, 4.0), columns
    expected = np.linalg.inv(dense(*given))
    errors = [
        np.abs(np.diag(np.linalg.inv(found)) / np.diag(expected) - 1.0).max()
        for found in (
            whitened_products(PARAMETERS, *given),
            added_products(PARAMETERS, *given, 0),
        )
    ]
    assert errors[0] < 0.6 * errors[1]
    assert errors[0] < 0.1


@pytest.mark.parametrize("before", [0, 3, 400])
def test_nearest_earlier_ones(before):
    """Against sorting the distances to all before."""
    positions = np.random.default_rng(1).uniform(0.0, 1.0, (before + 50, 2))
    index = PlaceIndex.of(positions[:before])
    found = nearest_earlier(index, positions[before:], 10)
    assert found.shape == (50, 10)
    for number, chosen in enumerate(found, start=before):
        distance = np.linalg.norm(positions[:number] - positions[number], axis=1)
        assert set(chosen) - {-1} == set(np.argsort(distance)[:10])
        assert (chosen < 0).sum() == max(0, 10 - number)
