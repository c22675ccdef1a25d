"""The snapshot service: rounds and cells in whole numbers, and what each mote knows."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from planopt.pursuit import ServiceBounds, SnapshotService, Track, relative_error, snapshot


@given(frames=st.integers(-500, 5000), hops=st.integers(3, 6), divisor=st.integers(1, 4))
def test_last_round_in_whole_numbers(frames, hops, divisor):
    """The last round of every level that has ended, counted in frames."""
    service = SnapshotService(5, 2.0, 0.1, 2, hops, divisor)
    found = service.sample_numbers(frames * service.frame_s)
    for level, number in enumerate(found):
        length = hops * 2**level
        ended = [k for k in range(-400, 2000) if k * divisor * length + length <= frames]
        assert number == max(ended) == Fraction(frames - length, divisor * length) // 1


def test_bounds_of_the_plain_service():
    """The constant 12 of equation 8.8, k = 2^c / sqrt 2, and the floors."""
    found = SnapshotService(6, 5.0, 0.02, 3).bounds
    assert found.age_s_m == pytest.approx(12 * 0.02 / 5.0)
    assert found.period_s_m == pytest.approx(6 * 0.02 / 5.0)
    assert found.age_floor_s == pytest.approx(6 * 0.02)
    assert found.relative_error == pytest.approx(np.sqrt(2) / 8)
    assert found.error_floor_m == pytest.approx(5.0 * np.sqrt(2) / 2)
    errors = [1 / relative_error(c) for c in range(1, 7)]
    assert errors == pytest.approx([1.41, 2.83, 5.66, 11.3, 22.6, 45.3], rel=5e-3)


def test_report_is_the_centre_of_the_sub_cell():
    """Positions are reported to the cell's side over 2^c, and no finer than one mote."""
    service = SnapshotService(5, 2.0, 0.1, 2)
    place = np.array([37.3, 11.9])
    assert service.cells(place, 0).tolist() == [18, 5]
    assert service.cells(place, 4).tolist() == [1, 0]
    assert service.reported_m(place, 0).tolist() == [37.0, 11.0]
    assert service.reported_m(place, 2).tolist() == [37.0, 11.0]
    # Level 4 has cells of 32 m; sub-cells of a quarter of that, 8 m.
    assert service.reported_m(place, 4).tolist() == [36.0, 12.0]
    assert service.error_bound_m(4) == pytest.approx(4.0 * np.sqrt(2))
    assert service.cells(np.array([64.0, 0.0]), 0).tolist() == [31, 0]


def test_bad_bounds():
    with refused():
        ServiceBounds(-1.0, 0.1)
    with refused():
        ServiceBounds(1.0, 0.1, period_s_m=float("inf"))


SERVICES = [
    SnapshotService(4, 1.0, 0.05, 2),
    SnapshotService(5, 3.0, 0.02, 3, hops_per_round=4),
    SnapshotService(6, 0.5, 0.1, 1, rate_divisor=3),
]


def walk(service, speed_m_s, steps, seed):
    """An object that turns at random, kept on the grid."""
    generator = np.random.default_rng(seed)
    step_s = 4.0 * service.frame_s
    turns = generator.normal(0.0, 0.3, steps).cumsum() + generator.uniform(0, 2 * np.pi)
    moves = speed_m_s * step_s * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    places = generator.uniform(0, service.side_m, 2) + np.vstack([[0, 0], moves.cumsum(axis=0)])
    # Folded back at the edges, which keeps the speed.
    places = np.abs(np.mod(places + service.side_m, 2 * service.side_m) - service.side_m)
    return Track(np.arange(steps + 1) * step_s, places)


def definition(service, track, time_s, mote):
    """Level, sample time and report of one mote, straight from the words."""
    for level in range(service.levels + 1):
        length_s = service.hops_per_round * service.frame_s * 2**level
        period_s = service.rate_divisor * length_s
        number = 0
        while number * period_s + length_s <= time_s + 1e-9:
            number += 1
        sampled_s = (number - 1) * period_s
        place = np.array([np.interp(sampled_s, track.times_s, x) for x in track.positions_m.T])
        side_m = service.mote_spacing_m * 2**level
        there = [int(min(x // side_m, 2 ** (service.levels - level) - 1)) for x in place]
        here = [number // 2**level for number in mote]
        if max(abs(there[0] - here[0]), abs(there[1] - here[1])) <= 1:
            fine_m = max(service.mote_spacing_m, side_m / 2**service.bits_per_axis)
            return level, sampled_s, (np.floor(place / fine_m) + 0.5) * fine_m
    raise AssertionError("the one cell of the last level holds every object")


@pytest.mark.parametrize("service", SERVICES)
def test_against_the_definition(service):
    """Level, sample time and report of every mote, one by one; map and list agree."""
    track = walk(service, 0.5 * service.mote_spacing_m / service.frame_s, 400, 1)
    generator = np.random.default_rng(2)
    first_s = float(service.rounds_s[-1])
    for time_s in generator.uniform(first_s, track.times_s[-1], 4):
        found = snapshot(service, track, time_s)
        levels = found.level_map()
        motes = generator.integers(0, service.motes_per_side, (150, 2))
        for mote in motes:
            assert found.shown_at(mote).argmax() == levels[mote[1], mote[0]]
            level, sampled_s, reported_m = definition(service, track, time_s, mote)
            assert levels[mote[1], mote[0]] == level
            assert found.sampled_s[level] == pytest.approx(sampled_s, abs=1e-9)
            np.testing.assert_allclose(found.reported_m[level], reported_m)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0, 2.5])
@pytest.mark.parametrize("service", SERVICES)
def test_bounds_hold_for_all_motes(service, share):
    """Age and error are below their bounds for every mote; each comes near somewhere.

    The distance is that to where the object was when the next finer level sampled, which showed it
    elsewhere. To the sampled place the age is bounded too, by the slope over
    ``1 - period_s_m * speed``. `share` is the speed over one mote a frame, times 12.
    """
    bounds = service.bounds
    speed = share / 12.0 * service.mote_spacing_m / service.frame_s
    track = walk(service, speed, 600, 3)
    along = (np.arange(service.motes_per_side) + 0.5) * service.mote_spacing_m
    centres = np.stack(np.meshgrid(along, along), axis=-1)
    closest = np.zeros(2)
    lag = 1.0 - bounds.period_s_m * speed
    for time_s in np.random.default_rng(4).uniform(0.0, track.times_s[-1], 60):
        found = snapshot(service, track, time_s)
        levels = found.level_map()
        ages_s = found.ages_s[levels]
        errors_m = np.linalg.norm(found.reported_m - found.sampled_m, axis=1)[levels]
        finer_m = np.vstack([found.sampled_m[:1], found.sampled_m[:-1]])
        away_m = np.abs(centres - finer_m[levels]).max(axis=-1)
        beyond = levels > 0
        assert (ages_s[~beyond] < bounds.age_floor_s).all()
        assert (ages_s[beyond] < bounds.age_s_m * away_m[beyond]).all()
        limit_m = np.maximum(bounds.error_floor_m, bounds.relative_error * away_m)
        assert (errors_m <= limit_m * (1 + 1e-12)).all()
        if lag > 0.0:
            sampled_m = np.linalg.norm(centres - found.sampled_m[levels], axis=-1)[beyond]
            assert (ages_s[beyond] < bounds.age_s_m / lag * sampled_m).all()
            relative = errors_m[beyond] / np.maximum(
                bounds.error_floor_m, bounds.relative_error / lag * sampled_m
            )
            assert relative.max() <= 1.0 + 1e-12
        shares = ages_s[beyond] / (bounds.age_s_m * away_m[beyond]), errors_m / limit_m
        closest = np.maximum(closest, [each.max() for each in shares])
    assert (closest > 0.6).all()


def test_object_off_the_grid():
    """An object that left the grid is refused."""
    with refused():
        snapshot(SERVICES[0], Track(np.zeros(1), np.array([[-0.1, 3.0]])), 1.0)


def test_endless_grid():
    """Beyond the edges levels go on; what is farther than the coarsest level shows is not known."""
    inside, endless = (SnapshotService(3, 1.0, 0.1, 2, endless=each) for each in (False, True))
    place = Track(np.zeros(1), np.array([[3.5, 4.5]]))
    moved = Track(np.zeros(1), np.array([[3.5 - 16.0, 4.5 + 32.0]]))
    np.testing.assert_array_equal(
        snapshot(inside, place, 1.0).level_map(), snapshot(endless, place, 1.0).level_map()
    )
    assert (snapshot(endless, moved, 1.0).level_map() == -1).all()
    near = snapshot(endless, moved, 1.0)
    motes = np.stack(np.meshgrid(np.arange(8), np.arange(8)), axis=-1).reshape(-1, 2)
    shown = [int(near.shown_at(mote + [-16, 32]).argmax()) for mote in motes]
    np.testing.assert_array_equal(
        np.reshape(shown, (8, 8)), snapshot(inside, place, 1.0).level_map()
    )
