"""Lines from moving discs: whoever keeps both rows keeps the distance all the way."""

import numpy as np
import pytest

from planopt.world.motion import closest_approach_m
from planopt.world.moving_discs import (
    MovingDiscs,
    joined_discs,
    passing_gaps_m,
    path_distances_m,
    paths_gap_m,
)
from planopt.world.separation import moving_lines

STEPS = 6


def random_discs(generator, count):
    """Discs on random walks, some asked a distance of their own from."""
    centres = np.cumsum(generator.normal(size=(count, STEPS + 1, 2)), axis=1) * 2.0
    return MovingDiscs(
        tuple(f"m{k}" for k in range(count)),
        centres,
        generator.uniform(0.1, 1.0, (count, STEPS)),
        generator.uniform(0.2, 1.5, count),
        generator.random(count) < 0.5,
    )


@pytest.mark.parametrize("seed", range(8))
def test_both_rows_keep_the_distance(seed):
    """Random segments that keep the rows keep the distance; the start path keeps its own gap."""
    generator = np.random.default_rng(seed)
    discs = random_discs(generator, 3)
    path = np.cumsum(generator.normal(size=(STEPS + 1, 2)), axis=0)
    clearance = 0.4
    lines = moving_lines(discs, path, clearance, 3, np.inf)
    near = path_distances_m(discs, path)
    kept = 0
    for k in range(STEPS):
        for j in range(3):
            disc, n = lines.piece[k, j], lines.normals[k, j]
            assert np.linalg.norm(n) == pytest.approx(1.0)
            gap = near[disc, k] - discs.apart_m[disc, k] + clearance
            assert lines.gaps[k, j] == pytest.approx(gap)
            assert n @ path[k] - lines.start_offsets[k, j] >= gap - 1e-9
            assert n @ path[k + 1] - lines.offsets[k, j] >= gap - 1e-9
            begins, ends = generator.normal(scale=6.0, size=(2, 400, 2))
            keeps = (begins @ n - lines.start_offsets[k, j] >= clearance) & (
                ends @ n - lines.offsets[k, j] >= clearance
            )
            kept += int(keeps.sum())
            gaps = passing_gaps_m(discs, k, begins[keeps], ends[keeps])[disc]
            assert (gaps >= -1e-9).all()
    assert kept > 100


def test_nearest_discs_have_the_lines():
    """Fewer lines than discs; those far away get none, those that are needed always."""
    generator = np.random.default_rng(1)
    discs = random_discs(generator, 6)
    path = np.cumsum(generator.normal(size=(STEPS + 1, 2)), axis=0)
    gaps = path_distances_m(discs, path) - discs.apart_m
    lines = moving_lines(discs, path, 0.0, 2, np.inf)
    assert (np.sort(np.argsort(gaps, axis=0)[:2].T) == np.sort(lines.piece)).all()
    none = moving_lines(discs, path, 0.0, 2, -100.0)
    assert (none.piece == -1).all()
    assert np.isinf(none.gaps).all()
    worst = np.zeros(gaps.shape, dtype=bool)
    worst[gaps.argmax(axis=0), np.arange(STEPS)] = True
    needed = moving_lines(discs, path, 0.0, 2, -100.0, worst)
    assert (needed.piece[:, 0] == gaps.argmax(axis=0)).all()


def test_a_path_through_the_centre_has_a_line_across_it():
    """No direction leads from the centre to it, and neither does any from a shared standstill."""
    centres = np.zeros((1, 2, 2))
    one, flag = np.ones((1, 1)), np.zeros(1, dtype=bool)
    disc = MovingDiscs(("m",), centres, one, np.zeros(1), flag)
    through = moving_lines(disc, np.array([[-1.0, 0.0], [1.0, 0.0]]), 0.0, 1, np.inf)
    assert abs(through.normals[0, 0, 1]) == 1.0
    assert through.gaps[0, 0] == -1.0
    shared = moving_lines(disc, np.zeros((2, 2)), 0.0, 1, np.inf)
    assert np.linalg.norm(shared.normals[0, 0]) == 1.0


def test_many_ways_at_once():
    """The least gap of a way is the least over discs and steps, one by one."""
    generator = np.random.default_rng(3)
    discs = joined_discs(random_discs(generator, 2), random_discs(generator, 2))
    ways = np.cumsum(generator.normal(size=(5, STEPS + 1, 2)), axis=1)
    expected = [
        min(
            float(closest_approach_m(way[k], way[k + 1], c[k], c[k + 1])) - discs.apart_m[number, k]
            for number, c in enumerate(discs.centres_m)
            for k in range(STEPS)
        )
        for way in ways
    ]
    np.testing.assert_allclose(paths_gap_m(discs, ways), expected)
