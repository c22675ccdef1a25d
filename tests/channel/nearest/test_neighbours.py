"""Nearest positions, blocks and windows against brute force."""

import numpy as np
import pytest

from planopt.channel.neighbours import (
    MOST_UNTREED,
    PlaceIndex,
    earlier_windows,
    place_blocks,
    surrounding_windows,
)

CENTRES = np.random.default_rng(8).uniform(0.0, 1.0, (25, 2))


def scattered(count, seed=2):
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


def uneven(count, seed=0):
    return np.random.default_rng(seed).uniform(0.0, 1.0, (count, 2)) ** [1.0, 3.0] * [100.0, 300.0]


@pytest.mark.parametrize("count", [0, 1, 20, 21, 333])
def test_blocks_are_a_partition(count):
    """Every measurement is in one block, and no block is larger than specified, or much smaller."""
    blocks = place_blocks(uneven(count), 20)
    assert sorted(np.concatenate([*blocks, np.zeros(0, int)])) == list(range(count))
    sizes = [len(block) for block in blocks]
    assert max(sizes, default=0) <= 20
    assert count <= 20 or min(sizes) >= 10


def test_surrounding_windows_have_the_nearest():
    """Those nearest to any member of the block, and none of the block."""
    points = uneven(200)
    for window in surrounding_windows(points, place_blocks(points, 12), 30):
        others = np.setdiff1d(np.arange(200), window.own)
        apart = np.linalg.norm(points[others, None] - points[window.own], axis=2).min(axis=1)
        nearest = others[np.argsort(apart)[:30]]
        assert set(window.near) <= set(others) and len(window.near) == 30
        # Candidates are preselected by the block's box: nearly all are the nearest.
        assert len(set(window.near) & set(nearest)) >= 27
        np.testing.assert_array_equal(window.rows[-len(window.own) :], window.own)


def test_earlier_windows_look_back_only():
    """Beside a block are members of earlier blocks alone; the first blocks are far apart."""
    points = uneven(300)
    before = set()
    windows = earlier_windows(points, place_blocks(points, 25), 40)
    for window in windows:
        assert set(window.near) <= before
        assert len(window.near) == min(40, len(before))
        before |= set(window.own)
    assert before == set(range(300))
    points = np.random.default_rng(2).uniform(0.0, 1.0, (1000, 2))
    centres = [
        points[w.own].mean(axis=0) for w in earlier_windows(points, place_blocks(points, 25), 9)
    ]
    apart = np.linalg.norm(np.array(centres[:6])[:, None] - centres[:6], axis=2)
    assert apart[np.triu_indices(6, 1)].min() > 0.3
