"""Violation of the motion model."""

import numpy as np
import pytest

from planopt.robots.drive import dynamics_defect_m

PATH = np.array([[1.0, 1.0], [4.0, 1.0], [4.0, 5.0], [4.0, 5.0]])
START = np.array([1.0, 1.0])


def test_a_path_within_the_speed_has_none():
    """Steps of 3, 4 and 0 m are allowed where 4 m are; a shorter limit is missed by the rest."""
    assert dynamics_defect_m(PATH, START, 4.0) == 0.0
    assert dynamics_defect_m(PATH, START, 3.5) == pytest.approx(0.5)
    assert dynamics_defect_m(PATH, START, 2.0) == pytest.approx(2.0)


def test_a_path_that_begins_elsewhere_jumps():
    """The jump to its first place counts even where every step is short enough."""
    assert dynamics_defect_m(PATH, np.array([1.0, 4.0]), 10.0) == pytest.approx(3.0)
    assert dynamics_defect_m(PATH, np.array([1.0, 1.5]), 2.0) == pytest.approx(2.0)


def test_a_path_without_steps_can_only_jump():
    """One place: its distance from the robot."""
    assert dynamics_defect_m(PATH[:1], START, 1.0) == 0.0
    assert dynamics_defect_m(PATH[:1], np.array([1.0, 3.0]), 1.0) == 2.0


def test_not_a_number_is_no_small_defect():
    """NaN in a path is never taken for a path that keeps the model."""
    broken = PATH.copy()
    broken[2] = np.nan
    assert not dynamics_defect_m(broken, START, 4.0) <= 1e-5
