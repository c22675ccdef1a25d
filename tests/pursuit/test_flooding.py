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


def brute_loads(levels, heads):
    """Blocks sent by every mote in every frame of lossless floods, from hop distances alone."""
    side = 1 << levels
    rows, columns = np.indices((side, side))
    loads = np.zeros((3 << levels, side, side), dtype=int)
    for level in range(levels + 1):
        cell = 1 << level
        corner = cell // 2 if heads == "middle" else 0
        begins = cell // 2 if heads == "middle" else cell - 1
        for start in range(0, 3 << levels, 3 * cell):
            for row in range(side // cell):
                for column in range(side // cell):
                    near = np.maximum(abs(rows // cell - row), abs(columns // cell - column)) <= 1
                    hops = np.maximum(
                        abs(rows - (row * cell + corner)), abs(columns - (column * cell + corner))
                    )
                    np.add.at(loads, (start + begins + hops[near], rows[near], columns[near]), 1)
    return loads


@pytest.mark.parametrize("heads", ["first", "middle"])
def test_loads_by_hop_distances(heads):
    """Without limits a mote sends at its hop distance: the histogram of loads agrees."""
    levels = 4
    run = simulate_flooding(grid(levels), heads)
    expected = brute_loads(levels, heads)
    assert run.flood_blocks.sum() == expected.sum()
    assert run.mean_load == pytest.approx(
        (run.flood_blocks.sum() + run.gather_blocks.sum()) / expected.size
    )
    # States on their way to heads add to the loads.
    assert 0 <= run.peak_load - expected.max() <= 4
    assert run.keeps_rounds


@pytest.mark.parametrize("heads", ["first", "middle"])
@pytest.mark.parametrize("border_relays", [True, False])
@pytest.mark.parametrize("levels", [1, 2, 4])
def test_counts_equal_the_formula(levels, border_relays, heads):
    """Blocks of every level and round, edges included; the mean far from edges bounds them."""
    service = grid(levels)
    run = simulate_flooding(service, heads, border_relays)
    rounds = 1 << np.arange(levels, -1, -1)
    expected = rounds * flood_blocks_per_round(service, border_relays)
    np.testing.assert_array_equal(run.flood_blocks, expected)
    assert (
        run.keeps_rounds and run.due.sum() == (rounds * flood_blocks_per_round(service, True)).sum()
    )
    a_frame = expected.sum() / (run.frames * service.motes_per_side**2)
    assert a_frame < mean_blocks_per_frame(border_relays, levels)
    # Three paths of 2^(j-1) hops for each cell and round, or four of half of that.
    paths = {"first": 3 * 2.0, "middle": 4.0}[heads]
    for level in range(2, levels + 1):
        cells = 4 ** (levels - level) * rounds[level]
        assert run.gather_blocks[level] == paths * 2.0 ** (level - 2) * cells


def test_mean_blocks():
    """3 (2 - 2^-L) blocks a frame, and 6 - 16/3 + 32/21 without the border's."""
    assert mean_blocks_per_frame(True, 6) == pytest.approx(3 * (2 - 2**-6))
    assert mean_blocks_per_frame(True, 60) == pytest.approx(6.0)
    assert mean_blocks_per_frame(False, 60) == pytest.approx(6 - 16 / 3 + 32 / 21)


@pytest.mark.parametrize(
    ("heads", "border_relays", "fails", "keeps"),
    [("first", True, 6, 16), ("middle", True, 6, 9), ("middle", False, 2, 4)],
)
def test_slots_and_rounds(heads, border_relays, fails, keeps):
    """A slot for the mean load, 6 blocks, breaks rounds; what keeps them is less with both."""
    service = grid(5)
    assert not simulate_flooding(service, heads, border_relays, fails).keeps_rounds
    run = simulate_flooding(service, heads, border_relays, keeps)
    assert run.keeps_rounds and run.peak_load <= keeps


def test_a_slot_for_the_peak_changes_nothing():
    """With room for the largest load no mote waits: the loads are those without a limit."""
    free = simulate_flooding(grid(4))
    tight = simulate_flooding(grid(4), slot_blocks=free.peak_load)
    np.testing.assert_array_equal(free.motes_by_load, tight.motes_by_load)


@pytest.mark.parametrize("levels", [1, 2, 3, 4, 5, pytest.param(8, marks=pytest.mark.slow)])
@pytest.mark.parametrize("border_relays", [True, False])
def test_peak_load(border_relays, levels):
    """The tabled peak loads are those of simulated floods, also with fewer rounds."""
    peak = peak_blocks_per_frame(border_relays, levels)
    assert simulate_flooding(grid(levels), border_relays=border_relays).peak_load == peak
    assert peak <= 8 * (levels + 1) and late_shares(levels, border_relays, peak) == (0.0,) * (
        levels + 1
    )
    if levels < 5:
        for divisor in (2, 3):
            service = SnapshotService(levels, 1.0, 0.01, 3, rate_divisor=divisor)
            run = simulate_flooding(service, border_relays=border_relays)
            assert run.peak_load <= peak and run.keeps_rounds


def test_late_shares():
    """They are late records over due ones; large grids with narrow slots are not simulated."""
    run = simulate_flooding(grid(4), slot_blocks=6)
    assert late_shares(4, True, 6) == tuple(run.late / run.due) and run.late.any()
    assert late_shares(8, True, 38) is None
    assert late_shares(12, True, 8 * 13) == (0.0,) * 13
