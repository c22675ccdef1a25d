import math

import numpy as np
import pytest

from planopt.errors import InputError
from planopt.world.workspace import footprint

SQUARE = [(0, 0), (4, 0), (4, 4), (0, 4)]


@pytest.mark.parametrize("ring", [SQUARE, [*SQUARE, SQUARE[0]], SQUARE[::-1], np.array(SQUARE)])
def test_closing_direction_and_type_do_not_matter(ring: object) -> None:
    """A ring means the same open or closed, either way round, as list or array."""
    assert footprint("a", ring).polygon.area == 16.0


def test_holes_and_heights() -> None:
    """Holes are cut out and heights left out."""
    polygon = footprint(
        "a", [(*corner, 7) for corner in SQUARE], [[(1, 1), (2, 1), (2, 2)]]
    ).polygon
    assert polygon.area == 15.5
    assert not polygon.has_z


def test_spike_is_repaired() -> None:
    """A spike has no area, so removing it leaves one meaning."""
    polygon = footprint("a", [(0, 0), (4, 0), (4, 4), (2, 4), (2, 9), (2, 4), (0, 4)]).polygon
    assert polygon.is_valid
    assert polygon.bounds == (0, 0, 4, 4)


def test_hole_on_the_border_is_repaired() -> None:
    """A hole that shares a side with the outline is a notch."""
    polygon = footprint("a", SQUARE, [[(0, 1), (0, 2), (1, 2), (1, 1)]]).polygon
    assert polygon.is_valid
    assert polygon.area == 15.0


@pytest.mark.parametrize(
    ("ring", "holes", "says"),
    [
        ([(0, 0), (4, 4), (4, 0), (0, 5)], [], "Self-intersection"),
        ([(0, 0), (4, 4), (4, 0), (0, 4)], [], "no area"),
        ([(0, 0), (1, 0), (2, 0)], [], "no area"),
        ([(0, 0), (1, 0), (0, 0)], [], "2 different corners"),
        (SQUARE, [[(9, 9), (8, 9), (8, 8)]], "Hole lies outside"),
        (SQUARE, [[(1, 1), (2, 1)]], "2 different corners"),
        ([(0, 0), (math.nan, 0), (1, 1)], [], "nan"),
        ([(0, 0), (math.inf, 0), (1, 1)], [], "inf"),
        ([(0, 0), (10**400, 0), (1, 1)], [], "not a place"),
        ([(0, 0), ("1", 0), (1, 1)], [], "pair of numbers"),
        ([(0, 0), (True, 0), (1, 1)], [], "pair of numbers"),
        ([(0, 0), "12", (1, 1)], [], "pair of numbers"),
        ([(0, 0), (1,), (1, 1)], [], "pair of numbers"),
        ([(0, 0), 5, (1, 1)], [], "pair of numbers"),
        ("ring", [], "must be a list"),
        (None, [], "must be a list"),
    ],
)
def test_bad_rings_are_named(ring: object, holes: list[object], says: str) -> None:
    """Whatever cannot be one polygon is an error with the feature and the reason."""
    with pytest.raises(InputError, match=says) as caught:
        footprint("Town Hall", ring, holes)
    assert caught.value.message.startswith("Town Hall: ")
