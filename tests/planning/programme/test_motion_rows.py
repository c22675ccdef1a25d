"""Rows of the dynamics: one formula for CasADi and NumPy, gradients against differences."""

from __future__ import annotations

import numpy as np
import pytest
from motion_scene import DOUBLE, WHEELS

from planopt.planning.programme.motion_rows import MotionShape, motion_row_values, motion_rows
from planopt.robots.drive import rolled_out


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_values_and_gradients_are_differences(dynamics) -> None:
    """At a random point."""
    shape = MotionShape(dynamics, 0.5, 3, 2)
    generator = np.random.default_rng(4)
    start = generator.normal(size=len(dynamics.state_names))
    q, w = generator.normal(size=6), generator.normal(size=shape.variables)
    line = generator.normal(size=4 * 4 * 2)
    found, slope = motion_row_values(shape, q.reshape(3, 2), w, start, line)

    def values(x):
        return np.array(motion_rows(shape, x[:6], x[6:], tuple(start), line).stacked())

    x, h = np.concatenate([q, w]), 1e-5
    assert found == pytest.approx(values(x), abs=1e-12)
    for number, step in enumerate(h * np.eye(len(x))):
        change = (values(x + step) - values(x - step)) / (2.0 * h)
        np.testing.assert_allclose(slope[:, number], change, atol=1e-7)


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_a_drive_keeps_its_rows(dynamics) -> None:
    """What inputs lead to has no defect; a place moved by a millimetre has one of a millimetre."""
    shape = MotionShape(dynamics, 0.5, 4, 1)
    inputs = np.tile([0.3, 0.2], (4, 1))
    drive = rolled_out(dynamics, np.zeros(len(dynamics.state_names)), inputs, 0.5)
    q, w = drive.states[1:, :2].ravel(), shape.variables_of(drive)
    assert shape.inputs_of(w) == pytest.approx(inputs)
    line = np.zeros(4 * 5)
    rows = motion_rows(shape, q, w, tuple(drive.states[0]), line)
    assert np.abs(rows.defect).max() <= 1e-14
    assert max(rows.limit) <= 0.0
    moved = motion_rows(shape, q + [0, 0, 1e-3, 0, 0, 0, 0, 0], w, tuple(drive.states[0]), line)
    assert np.abs(moved.defect).max() == pytest.approx(1e-3)
    lower, upper = rows.bounds((0.0, 0.0, 1.0, 2.0))
    assert len(lower) == len(upper) == len(rows.stacked())
