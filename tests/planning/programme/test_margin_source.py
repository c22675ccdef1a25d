"""What the solver's callbacks evaluate: once a point, and never what an earlier solve left."""

import numpy as np
import pytest

from planopt.planning.programme.margin_source import MarginSource, StageMargins


class Counter:
    """Margins that tell how often they were asked for, and where."""

    def __init__(self, offset):
        self.offset = offset
        self.asked = []

    def __call__(self, positions_m):
        """Sum of the coordinates plus the offset."""
        self.asked.append(positions_m.copy())
        n = len(positions_m)
        return StageMargins(positions_m.sum(1) + self.offset, np.ones((n, 2)), np.zeros((n, 3)))


FLAT = np.array([1.0, 2.0, 3.0, 4.0])


def test_a_point_is_computed_once():
    """Value, gradient and Hessian at one point are one evaluation, at positions row by row."""
    counter, source = Counter(0.0), MarginSource(2)
    source.use(counter)
    first = source.at(FLAT)
    assert source.at(FLAT.copy()) is first
    np.testing.assert_array_equal(first.value, [3.0, 7.0])
    assert len(counter.asked) == 1
    np.testing.assert_array_equal(counter.asked[0], [[1.0, 2.0], [3.0, 4.0]])


def test_another_point_is_computed_anew():
    """The last bit of one coordinate is another point; a point come back to is computed again."""
    counter, source = Counter(0.0), MarginSource(2)
    source.use(counter)
    source.at(FLAT)
    moved = FLAT.copy()
    moved[3] = np.nextafter(4.0, 5.0)
    assert source.at(moved).value[1] == moved[2] + moved[3]
    source.at(FLAT)
    assert len(counter.asked) == 3


def test_a_point_changed_in_place_is_another_point():
    """The solver writes its iterates into one array: contents count, not identity."""
    counter, source = Counter(0.0), MarginSource(1)
    source.use(counter)
    place = np.array([1.0, 2.0])
    source.at(place)
    place += 1.0
    assert source.at(place).value[0] == 5.0


def test_a_new_function_forgets_what_the_last_one_gave():
    """The same point under another function has another value."""
    source = MarginSource(2)
    source.use(Counter(0.0))
    source.at(FLAT)
    source.use(Counter(100.0))
    np.testing.assert_array_equal(source.at(FLAT).value, [103.0, 107.0])


def test_a_failing_function_leaves_nothing_behind():
    """After an error the point is computed again, not answered from the point before it."""

    def broken(_positions_m):
        raise ValueError("broken")

    source = MarginSource(2)
    source.use(broken)
    for _ in range(2):
        with pytest.raises(ValueError, match="broken"):
            source.at(FLAT)


def test_nothing_to_evaluate_is_a_mistake_of_the_caller():
    """A solver called before it has margins says so."""
    with pytest.raises(AssertionError, match="before its margins"):
        MarginSource(2).at(FLAT)
