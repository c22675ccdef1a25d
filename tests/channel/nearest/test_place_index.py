"""Nearest places against sorting all distances."""

import numpy as np
import pytest

from planopt.channel.neighbours import MOST_UNTREED, PlaceIndex

CENTRES = np.random.default_rng(8).uniform(0.0, 1.0, (25, 2))


def scattered(count, seed=2):
    """Places of the unit square."""
    return np.random.default_rng(seed).uniform(0.0, 1.0, (count, 2))


def assert_nearest(index, positions, count):
    """The same as sorting; the farthest used one's distance is reported."""
    indices, farthest = index.nearest(CENTRES, count)
    assert indices.shape == (len(CENTRES), count)
    for centre, chosen, reach in zip(CENTRES, indices, farthest, strict=True):
        distance = np.linalg.norm(positions - centre, axis=1)
        assert set(chosen) == set(np.argsort(distance)[:count])
        assert np.sqrt(reach) == pytest.approx(np.sort(distance)[count - 1])


@pytest.mark.parametrize("total", [20, MOST_UNTREED, MOST_UNTREED + 1, 2000])
@pytest.mark.parametrize("count", [1, 7, 19])
def test_nearest_finds_the_nearest(total, count):
    """With and without a tree."""
    positions = scattered(total)
    assert_nearest(PlaceIndex.of(positions), positions, count)


def test_places_that_came_after_the_tree_are_found():
    """Grown singly past several trees, an index finds what a new one does, and so do older ones."""
    positions = scattered(1500)
    index = older = PlaceIndex.of(positions[:300])
    trees = set()
    for stop in range(301, 1501):
        index = index.grown(positions[:stop])
        trees.add(id(index.tree))
        if stop in (301, 500, 556, 557, 900, 1500):
            assert_nearest(index, positions[:stop], 40)
            assert_nearest(index, positions[:stop], 299)
        older = index if stop == 700 else older
    assert 2 < len(trees) < 10
    assert_nearest(older, positions[:700], 12)


def test_more_than_the_tree_holds():
    """A count above the number of places in the tree, yet below all."""
    positions = scattered(700)
    index = PlaceIndex.of(positions[:500]).grown(positions)
    assert index.tree is not None and len(index.tree) == 500
    assert_nearest(index, positions, 650)


def test_taking_everyone_leaves_the_reach_open():
    """Where all are taken the next measurement will be taken too, however far."""
    for total in (0, 3):
        indices, farthest = PlaceIndex.of(np.zeros((total, 2))).nearest(CENTRES, 3)
        assert indices.shape == (25, total)
        assert np.isinf(farthest).all()
