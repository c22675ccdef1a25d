"""Rounds hop by hop: counts against closed forms, slots against deadlines, lost hops."""

import numpy as np
import pytest

from planopt.errors import InputError
from planopt.pursuit.network import (
    Flooding,
    mean_blocks_per_frame,
    simulate_flooding,
)
from planopt.pursuit.service import SnapshotService


def flood_blocks_per_round(service, border_relays):
    """Blocks that one round of each level floods, as cells at edges have fewer neighbours."""
    cell = 1 << np.arange(service.levels + 1)
    along = 3 * service.motes_per_side - 2 * cell
    if not border_relays:
        along = along - 2 * (service.motes_per_side // cell) + 2
    return along * along


def grid(levels, **changes):
    """A grid of that many levels."""
    return SnapshotService(levels, 1.0, 0.01, 3, **changes)


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
    run = simulate_flooding(grid(levels), Flooding(heads))
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
@pytest.mark.parametrize("levels", [1, 2, 3, 5])
def test_counts_equal_the_formula(levels, border_relays, heads):
    """Blocks of every level and round, edges included; the mean far from edges bounds them."""
    service = grid(levels)
    run = simulate_flooding(service, Flooding(heads, border_relays))
    rounds = 1 << np.arange(levels, -1, -1)
    expected = rounds * flood_blocks_per_round(service, border_relays)
    np.testing.assert_array_equal(run.flood_blocks, expected)
    assert (
        run.keeps_rounds and run.due.sum() == (rounds * flood_blocks_per_round(service, True)).sum()
    )
    a_frame = expected.sum() / (run.frames * service.motes_per_side**2)
    assert a_frame < mean_blocks_per_frame(border_relays, levels)
    # Three ways of 2^(j-1) hops for each cell and round, or four of half of that.
    ways = {"first": 3 * 2.0, "middle": 4.0}[heads]
    for level in range(2, levels + 1):
        cells = 4 ** (levels - level) * rounds[level]
        assert run.gather_blocks[level] == ways * 2.0 ** (level - 2) * cells


def test_mean_blocks():
    """3 (2 - 2^-L) blocks a frame, and 6 - 16/3 + 32/21 without the border's."""
    assert mean_blocks_per_frame(True, 6) == pytest.approx(3 * (2 - 2**-6))
    assert mean_blocks_per_frame(True) == pytest.approx(6.0)
    assert mean_blocks_per_frame(False) == pytest.approx(6 - 16 / 3 + 32 / 21)


def test_count_approaches_the_mean():
    """On larger grids edges matter less: the closed form tends to the mean far from them."""
    shares = []
    for levels in (4, 6, 8, 10):
        service = grid(levels)
        frames = service.hops_per_round << np.arange(levels + 1)
        blocks = flood_blocks_per_round(service, True) / frames
        shares.append(
            blocks.sum() / service.motes_per_side**2 / mean_blocks_per_frame(True, levels)
        )
    assert (np.diff(shares) > 0).all() and shares[-1] > 0.99


@pytest.mark.parametrize(
    ("heads", "border_relays", "fails", "keeps"),
    [("first", True, 6, 16), ("middle", True, 6, 9), ("middle", False, 2, 4)],
)
def test_slots_and_rounds(heads, border_relays, fails, keeps):
    """A slot for the mean load, 6 blocks, breaks rounds; what keeps them is less with both."""
    service = grid(5)
    assert not simulate_flooding(service, Flooding(heads, border_relays, fails)).keeps_rounds
    run = simulate_flooding(service, Flooding(heads, border_relays, keeps))
    assert run.keeps_rounds and run.peak_load <= keeps


def test_a_slot_for_the_peak_changes_nothing():
    """With room for the largest load nobody waits: the loads are those without a limit."""
    free = simulate_flooding(grid(4), Flooding())
    tight = simulate_flooding(grid(4), Flooding(slot_blocks=free.peak_load))
    np.testing.assert_array_equal(free.motes_by_load, tight.motes_by_load)


def lossy(loss, hops=3, seed=0, **options):
    """Shares of late pairs and of missing states, by level, on a small grid."""
    run = simulate_flooding(
        grid(4, hops_per_round=hops),
        Flooding(hop_loss=loss, **options),
        np.random.default_rng(seed),
    )
    return run.late / run.due, run.missing / run.states


def test_floods_survive_lost_hops():
    """Most motes hear another neighbour; border relays and repeats make fewer of them late."""
    plain = lossy(0.3)[0]
    assert 0.0 < plain.max() < 0.03
    assert lossy(0.3, border_relays=False)[0].sum() > 3 * plain.sum()
    assert lossy(0.3, repeats=2, hops=4)[0].sum() < 0.1 * plain.sum()


def test_states_need_spare_time():
    """Three hops a round leave states no time to be repeated; longer rounds do, if heads wait."""
    assert lossy(0.1)[1][-1] > 0.2
    waiting = lossy(0.1, hops=5, gather_share=0.7)
    assert waiting[1].max() < 0.02 and waiting[0].max() < 2e-3
    assert lossy(0.1, heads="middle", gather_share=0.7)[1].max() < 0.05


def test_a_first_hop_is_heard_as_often_as_stated():
    """Level 0 has one hop: the share of late pairs is the loss, for eight neighbours of nine."""
    service, loss = grid(5), 0.4
    run = simulate_flooding(
        service, Flooding(border_relays=False, hop_loss=loss), np.random.default_rng(1)
    )
    hops = run.due[0] - (1 << 5) * service.motes_per_side**2
    deviation = np.sqrt(hops * loss * (1 - loss))
    assert abs(run.late[0] - loss * hops) < 4 * deviation


def test_a_state_is_sent_until_it_is_heard():
    """Level 1 has one hop for three of four states: those not heard in its frame are missing."""
    run = simulate_flooding(grid(5), Flooding(hop_loss=0.5), np.random.default_rng(2))
    deviation = np.sqrt(0.75 * run.states[1] * 0.25)
    assert abs(run.missing[1] - 0.375 * run.states[1]) < 4 * deviation
    patient = simulate_flooding(
        grid(4, hops_per_round=20),
        Flooding(gather_share=0.9, hop_loss=0.5),
        np.random.default_rng(3),
    )
    sure = simulate_flooding(grid(4), Flooding()).gather_blocks
    assert patient.missing.sum() == 0
    assert patient.gather_blocks[1:].sum() == pytest.approx(2 * sure[1:].sum(), rel=0.1)


def test_same_seed_same_run():
    """A seed fixes the losses."""
    runs = [
        simulate_flooding(grid(3), Flooding(hop_loss=0.2), np.random.default_rng(3))
        for _ in range(2)
    ]
    np.testing.assert_array_equal(runs[0].motes_by_load, runs[1].motes_by_load)


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"heads": "last"}, "heads"),
        ({"slot_blocks": 0}, "slot_blocks"),
        ({"repeats": 0}, "repeats"),
        ({"gather_share": 1.5}, "gather_share"),
        ({"hop_loss": 1.0}, "hop_loss"),
    ],
)
def test_bad_flooding(options, key):
    """Each option out of range is named."""
    with pytest.raises(InputError, match=f"key {key}"):
        Flooding(**options)


def test_losses_need_a_generator():
    """Randomness is passed in."""
    with pytest.raises(InputError, match="randomness"):
        simulate_flooding(grid(2), Flooding(hop_loss=0.1))
