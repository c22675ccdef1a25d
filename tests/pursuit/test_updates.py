"""Sparse and directed updates: motes know the same, for fewer blocks."""

import numpy as np
import pytest
from objects_on_grid import walk

from planopt.pursuit.knowledge import Track, snapshot
from planopt.pursuit.service import SnapshotService
from planopt.pursuit.updates import (
    Receiver,
    change_probability,
    expected_blocks_per_frame,
    record_floods,
)

SERVICE = SnapshotService(5, 1.0, 0.05, 2)


def memory(service, floods, time_s):
    """What every mote remembers at a time: per level the occupied cell as told, or (-1, -1)."""
    side = service.motes_per_side
    told = np.full((service.levels + 1, side, side, 2), -1)
    for level, one in enumerate(floods):
        order = np.argsort(one.sampled_s, kind="stable")
        for number in order:
            if one.sampled_s[number] + service.rounds_s[level] > time_s + 1e-9:
                continue
            (first, row), (last, end) = one.areas[number]
            area = told[level, row : end + 1, first : last + 1]
            if one.occupied[number]:
                area[...] = one.cells[number]
            else:
                area[(area == one.cells[number]).all(axis=-1)] = -1
    return told


@pytest.mark.parametrize("refresh", [None, 3])
def test_silence_tells_as_much(refresh):
    """Every mote that remembers what was flooded knows the cells that full rounds tell."""
    track = walk(SERVICE, 2.0, 200, 0)
    floods = record_floods(SERVICE, track, float(track.times_s[-1]), refresh_rounds=refresh)
    levels = np.arange(SERVICE.levels + 1)
    for time_s in (20.0, 29.3, 38.0):
        told = memory(SERVICE, floods, time_s)
        knows = (told >= 0).all(axis=-1).argmax(axis=0)
        found = snapshot(SERVICE, track, time_s)
        np.testing.assert_array_equal(knows, found.level_map())
        for level in levels:
            seen = told[level][(told[level] >= 0).all(axis=-1)]
            assert (seen == found.cells[level]).all()


def test_a_directed_pursuer_misses_nothing():
    """Whatever full rounds tell the mote under the pursuer, directed sparse ones tell it too."""
    evader, pursuer = walk(SERVICE, 2.0, 200, 5), walk(SERVICE, 4.0, 200, 6)
    duration_s = float(evader.times_s[-1])
    directed = record_floods(SERVICE, evader, duration_s, receiver=Receiver(pursuer, 4.0))
    for time_s in np.linspace(20.0, duration_s, 12):
        mote = SERVICE.cells(pursuer.at(np.array(time_s)), 0)
        told = memory(SERVICE, directed, time_s)[:, mote[1], mote[0]]
        found = snapshot(SERVICE, evader, time_s)
        level = int(found.shown_at(mote).argmax())
        np.testing.assert_array_equal(told[level], found.cells[level])
        assert (told[:level] == -1).all()
    plain = record_floods(SERVICE, evader, duration_s)
    assert sum(one.blocks for one in directed) < 0.7 * sum(one.blocks for one in plain)


def test_a_still_object_costs_its_first_records():
    """One flood a level, and with refreshing one in every so many rounds."""
    still = Track(np.zeros(1), np.array([[10.3, 7.7]]))
    once = record_floods(SERVICE, still, 60.0)
    assert [len(one.areas) for one in once] == [1] * 6
    again = record_floods(SERVICE, still, 60.0, refresh_rounds=4)
    assert [len(one.areas) for one in again] == [-(-one.rounds // 4) for one in again]
    assert once[-1].blocks == SERVICE.motes_per_side**2


@pytest.mark.parametrize("share", [0.0, 0.2, 0.7, 1.0, 1.3, 3.0])
def test_change_probability(share):
    """Against uniform places and directions; (4 q - q^2) / pi for moves within a side."""
    generator = np.random.default_rng(0)
    places, angles = generator.random((400_000, 2)), generator.uniform(0, 2 * np.pi, 400_000)
    ends = places + share * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    left = (np.floor(ends) != 0).any(axis=1).mean()
    assert change_probability(share) == pytest.approx(left, abs=4e-3)
    if share <= 1.0:
        assert change_probability(share) == pytest.approx((4 * share - share**2) / np.pi, abs=1e-6)


def test_expected_cost_far_from_edges():
    """Counted floods of straight moves in the middle of a large grid, by level."""
    service = SnapshotService(8, 1.0, 0.01, 2)
    speed = 12.0
    duration_s = 5.0
    generator = np.random.default_rng(1)
    blocks = np.zeros(5)
    expected = np.zeros(5)
    runs = 200
    for _ in range(runs):
        angle = generator.uniform(0, 2 * np.pi)
        start = generator.uniform(98, 158, 2)
        end = start + speed * duration_s * np.array([np.cos(angle), np.sin(angle)])
        track = Track(np.array([-1.0, 0.0, duration_s]), np.array([start, start, end]))
        for level, one in enumerate(record_floods(service, track, duration_s)[:5]):
            blocks[level] += one.blocks - 9 * 4**level
    for level in range(5):
        rounds = int(duration_s / service.periods_s[level])
        moved = speed * service.periods_s[level]
        fine = max(1.0, 2.0 ** (level - 2))
        floods = change_probability(moved / fine) + change_probability(moved / 2**level)
        expected[level] = runs * (rounds - 1) * floods * 9 * 4**level
    np.testing.assert_allclose(blocks, expected, rtol=0.06)
    a_frame = expected_blocks_per_frame(service, speed)
    # Its doubling from level to level makes it O(sqrt N).
    smaller = expected_blocks_per_frame(SnapshotService(7, 1.0, 0.01, 2), speed)
    assert a_frame / smaller == pytest.approx(2.0, rel=0.02)
