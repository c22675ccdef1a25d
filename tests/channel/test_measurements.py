"""Measurements refuse what does not fit, and join in order."""

from dataclasses import fields, replace

import numpy as np
import pytest

from planopt import InputError
from planopt.channel import Measurements
from planopt.channel.measurements import join

OPTIONAL = ("resolution_db", "position_std_m", "time_s", "receiver")


def some(count, start=0.0):
    """Numbered measurements."""
    values = start + np.arange(count, dtype=float)
    return Measurements(np.column_stack([values, values]), values, values % 2 == 1)


@pytest.mark.parametrize(
    ("positions", "power", "censored"),
    [((3, 2), 2, 2), ((2, 3), 2, 2), ((2, 2), 2, 3), ((2,), 2, 2)],
)
def test_shapes_must_agree(positions, power, censored):
    """A mismatch is our error, with the shapes in it."""
    with pytest.raises(InputError, match="shape"):
        Measurements(np.zeros(positions), np.zeros(power), np.zeros(censored, dtype=bool))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_must_be_finite(bad):
    """Neither a power nor a coordinate may be NaN or infinite."""
    with pytest.raises(InputError, match="not finite"):
        Measurements(np.zeros((1, 2)), np.array([bad]), np.array([False]))
    with pytest.raises(InputError, match="not finite"):
        Measurements(np.array([[0.0, bad]]), np.zeros(1), np.array([False]))


@pytest.mark.parametrize(("coordinate", "power"), [(1e160, -80.0), (1.0, -1e160)])
def test_numbers_must_be_possible(coordinate, power):
    """Squares of what passes do not overflow."""
    with pytest.raises(InputError, match="is none"):
        Measurements(np.array([[coordinate, 0.0]]), np.array([power]), np.array([False]))


def all_given(count, start=0.0):
    """Measurements with every field given, each value another."""
    values = start + np.arange(count, dtype=float)
    return Measurements(
        np.column_stack([values, values]),
        values,
        values % 2 == 1,
        resolution_db=values + 1.0,
        position_std_m=values + 2.0,
        time_s=values + 3.0,
        receiver=np.arange(count) + 4,
    )


def test_what_is_not_given_is_zero():
    """Of the length of the rest, and receivers are whole numbers."""
    plain = some(3)
    for name in OPTIONAL:
        np.testing.assert_array_equal(getattr(plain, name), np.zeros(3))
    assert plain.receiver.dtype == np.intp


@pytest.mark.parametrize(
    ("rows", "kept"),
    [
        (np.array([2, 0]), [2, 0]),
        (np.array([False, True, True, False]), [1, 2]),
        (slice(1, None), [1, 2, 3]),
        (slice(0, 0), []),
    ],
)
def test_take_takes_every_field(rows, kept):
    """By indices in their order, by a mask and by a slice."""
    whole = all_given(4)
    part = whole.take(rows)
    for field in fields(Measurements):
        np.testing.assert_array_equal(getattr(part, field.name), getattr(whole, field.name)[kept])


def test_join_joins_every_field():
    """Given ones after ones that were left out, and empty sets."""
    first, second = some(2), all_given(3)
    joined = join(first, second)
    for field in fields(Measurements):
        np.testing.assert_array_equal(
            getattr(joined, field.name),
            np.concatenate([getattr(first, field.name), getattr(second, field.name)]),
        )
    assert len(join(some(0), second)) == 3


@pytest.mark.parametrize("name", OPTIONAL)
def test_optional_fields_have_the_length(name):
    """Another shape is our error, with the field's name."""
    with pytest.raises(InputError, match=name):
        replace(some(3), **{name: np.zeros(2)})


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("resolution_db", -1.0),
        ("resolution_db", np.nan),
        ("position_std_m", -0.1),
        ("position_std_m", np.inf),
        ("time_s", np.nan),
    ],
)
def test_optional_fields_are_usable_numbers(name, bad):
    """Deviations and steps are at least 0, times finite."""
    with pytest.raises(InputError, match=r"negative or not finite|time of a measurement"):
        replace(some(1), **{name: np.array([bad])})
