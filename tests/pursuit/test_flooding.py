"""Rounds hop by hop: counts against closed forms, slots against deadlines."""

import numpy as np
import pytest

from planopt.pursuit import (
    SnapshotService,
    late_shares,
    mean_blocks_per_frame,
    peak_blocks_per_frame,
    simulate_flooding,
)


def flood_blocks_per_round(service, border_relays):
    """Blocks that one round of each level floods, as cells at edges have fewer neighbours."""
    cell = 1 << np.arange(service.levels + 1)
    along = 3 * service.motes_per_side - 2 * cell
    if not border_relays:
        along = along - 2 * (service.motes_per_side // cell) + 2
    return along * along


def grid(levels):
    return SnapshotService(levels, 1.0, 0.01, 3)


def brute_loads(levels):
    """Blocks sent by every mote in every frame of lossless floods, from hop distances alone."""
    side = 1 << levels
    rows, columns = np.indices((side, side))
    loads = np.zeros((3 << levels, side, side), dtype=int)
    for level in range(levels + 1):
        cell = 1 << level
        for start in range(0, 3 << levels, 3 * cell):
            for row in range(side // cell):
                for column in range(side // cell):
                    near = np.maximum(abs(rows // cell - row), abs(columns // cell - column)) <= 1
                    hops = np.maximum(abs(rows - row * cell), abs(columns - column * cell))[near]
                    np.add.at(loads, (start + cell - 1 + hops, rows[near], columns[near]), 1)
    return loads


def peak_load(run):
    """The largest number of blocks that any mote sends in any frame."""
    return len(run.motes_by_load) - 1


def test_loads_by_hop_distances():
    """Without limits a mote sends at its hop distance: the histogram of loads agrees."""
    levels = 4
    run = simulate_flooding(grid(levels))
    expected = brute_loads(levels)
    assert run.flood_blocks.sum() == expected.sum()
    blocks = np.arange(len(run.motes_by_load)) @ run.motes_by_load
    assert blocks == run.flood_blocks.sum() + run.gather_blocks.sum()
    # States on their way to heads add to the loads.
    assert 0 <= peak_load(run) - expected.max() <= 4
    assert not run.late.any()


@pytest.mark.parametrize("border_relays", [True, False])
@pytest.mark.parametrize("levels", [1, 2, 4])
def test_counts_equal_the_formula(levels, border_relays):
    """Blocks of every level and round, edges included; the mean far from edges bounds them."""
    service = grid(levels)
    run = simulate_flooding(service, border_relays)
    rounds = 1 << np.arange(levels, -1, -1)
    expected = rounds * flood_blocks_per_round(service, border_relays)
    np.testing.assert_array_equal(run.flood_blocks, expected)
    assert not run.late.any()
    assert run.due.sum() == (rounds * flood_blocks_per_round(service, True)).sum()
    a_frame = expected.sum() / (run.frames * service.motes_per_side**2)
    assert a_frame < mean_blocks_per_frame(border_relays, levels)
    # Three paths of 2^(j-1) hops for each cell and round.
    for level in range(2, levels + 1):
        cells = 4 ** (levels - level) * rounds[level]
        assert run.gather_blocks[level] == 3 * 2.0 ** (level - 1) * cells


def test_mean_blocks():
    """3 (2 - 2^-L) blocks a frame, and 6 - 16/3 + 32/21 without the border's."""
    assert mean_blocks_per_frame(True, 6) == pytest.approx(3 * (2 - 2**-6))
    assert mean_blocks_per_frame(True, 60) == pytest.approx(6.0)
    assert mean_blocks_per_frame(False, 60) == pytest.approx(6 - 16 / 3 + 32 / 21)


@pytest.mark.parametrize(("border_relays", "fails", "keeps"), [(True, 6, 16), (False, 2, 6)])
def test_slots_and_rounds(border_relays, fails, keeps):
    """A slot for the mean load, 6 blocks, breaks rounds; fewer keep them without border relays."""
    service = grid(5)
    assert simulate_flooding(service, border_relays, fails).late.any()
    run = simulate_flooding(service, border_relays, keeps)
    assert not run.late.any() and peak_load(run) <= keeps


def test_a_slot_for_the_peak_changes_nothing():
    """With room for the largest load no mote waits: the loads are those without a limit."""
    free = simulate_flooding(grid(4))
    tight = simulate_flooding(grid(4), slot_blocks=peak_load(free))
    np.testing.assert_array_equal(free.motes_by_load, tight.motes_by_load)


@pytest.mark.parametrize("levels", [1, 2, 3, 4, 5, pytest.param(8, marks=pytest.mark.slow)])
@pytest.mark.parametrize("border_relays", [True, False])
def test_peak_load(border_relays, levels):
    """The tabled peak loads are those of simulated floods, also with fewer rounds."""
    peak = peak_blocks_per_frame(border_relays, levels)
    assert peak_load(simulate_flooding(grid(levels), border_relays=border_relays)) == peak
    assert peak <= 8 * (levels + 1) and late_shares(levels, border_relays, peak) == (0.0,) * (
        levels + 1
    )
    if levels < 5:
        for divisor in (2, 3):
            service = SnapshotService(levels, 1.0, 0.01, 3, rate_divisor=divisor)
            run = simulate_flooding(service, border_relays=border_relays)
            assert peak_load(run) <= peak and not run.late.any()


def test_late_shares():
    """They are late records over due ones; large grids with narrow slots are not simulated."""
    run = simulate_flooding(grid(4), slot_blocks=6)
    assert late_shares(4, True, 6) == tuple(run.late / run.due) and run.late.any()
    assert late_shares(8, True, 38) is None
    assert late_shares(12, True, 8 * 13) == (0.0,) * 13
