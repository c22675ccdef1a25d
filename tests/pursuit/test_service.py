"""The snapshot service: its rounds, cells and slots against definitions in whole numbers."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planopt.errors import InputError
from planopt.pursuit.service import (
    ServiceBounds,
    SnapshotService,
    relative_error,
    slots,
    slots_per_frame,
)


def test_slots_are_a_colouring():
    """No two motes within two of each other share a slot, and nine slots are used."""
    found = slots(12)
    assert len(np.unique(found)) == slots_per_frame() == 9
    for down in range(-2, 3):
        for right in range(0, 3):
            if (down, right) > (0, 0):
                rows, moved = slice(max(0, -down), 12 - max(0, down)), slice(max(0, down), 12)
                a = found[rows, : 12 - right]
                b = found[moved if down >= 0 else slice(0, 12 + down), right:]
                assert (a != b).all(), (down, right)


@given(
    frames=st.integers(-500, 5000),
    hops=st.integers(3, 6),
    divisor=st.integers(1, 4),
)
def test_last_round_in_whole_numbers(frames, hops, divisor):
    """The last round of every level that has ended, counted in frames."""
    service = SnapshotService(5, 2.0, 0.1, 2, hops, divisor)
    found = service.sample_numbers(frames * service.frame_s)
    for level, number in enumerate(found):
        length = hops * 2**level
        ended = [k for k in range(-400, 2000) if k * divisor * length + length <= frames]
        assert number == max(ended) == Fraction(frames - length, divisor * length) // 1


@given(st.integers(3, 5), st.integers(1, 4), st.floats(0.0, 1e4))
def test_finer_levels_are_never_older(hops, divisor, time_s):
    """Sample times fall from level to level; ages lie between one round and the bound."""
    service = SnapshotService(6, 1.0, 0.37, 3, hops, divisor)
    ages_s = time_s - service.sample_numbers(time_s) * service.periods_s
    assert (np.diff(ages_s) >= -1e-9).all()
    assert (ages_s >= service.rounds_s * (1 - 1e-6)).all()
    assert (ages_s < service.rounds_s + service.periods_s).all()


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
    """Positions are told to the cell's side over 2^c, and no finer than one mote."""
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


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"levels": 0}, "levels"),
        ({"levels": 13}, "levels"),
        ({"levels": 2.5}, "levels"),
        ({"mote_spacing_m": 0.0}, "mote_spacing_m"),
        ({"frame_s": float("nan")}, "frame_s"),
        ({"bits_per_axis": 0}, "bits_per_axis"),
        ({"hops_per_round": 2}, "hops_per_round"),
        ({"rate_divisor": 0}, "rate_divisor"),
    ],
)
def test_bad_service(change, key):
    """Each number out of range is named."""
    good = {"levels": 4, "mote_spacing_m": 1.0, "frame_s": 0.1, "bits_per_axis": 2}
    with pytest.raises(InputError, match=f"key {key}"):
        SnapshotService(**{**good, **change})


def test_bad_bounds():
    """Bounds are finite and not negative."""
    with pytest.raises(InputError, match="age_s_m"):
        ServiceBounds(-1.0, 0.1)
    with pytest.raises(InputError, match="period_s_m"):
        ServiceBounds(1.0, 0.1, period_s_m=float("inf"))
