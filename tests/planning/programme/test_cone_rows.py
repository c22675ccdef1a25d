"""Rows that are cones: what they say is what the built programme computes."""

from __future__ import annotations

import numpy as np
import pytest
from motion_scene import DOUBLE, WHEELS

from planopt.planning.programme.motion_rows import MotionShape, motion_row_values
from planopt.planning.programme.path_shape import PathShape
from planopt.planning.programme.scp import motion_cones, no_cones, step_cones

N, LINES = 3, 2


def test_steps_of_a_path() -> None:
    """Half the gradients of squared lengths are the steps."""
    path = np.random.default_rng(0).normal(size=(N + 1, 2))
    steps = np.diff(path, axis=0)
    jacobian = np.zeros((N, 2 * N))
    for k in range(N):
        jacobian[k, 2 * k : 2 * k + 2] = 2.0 * steps[k]
        if k:
            jacobian[k, 2 * k - 2 : 2 * k] = -2.0 * steps[k]
    cones = step_cones(N)
    assert cones.pairs(jacobian) == pytest.approx(steps)
    assert cones.radii(np.full(N, 2.25)) == pytest.approx(np.full(N, 1.5))


@pytest.mark.parametrize("bounded", [False, True])
def test_discs_of_a_double_integrator(bounded) -> None:
    """Every acceleration and velocity, by the rows' own values and gradients."""
    motion = MotionShape(DOUBLE, 1.0, N, LINES)
    shape = PathShape(N, LINES, "stagewise", bounded=bounded, motion=motion)
    generator = np.random.default_rng(1)
    positions, w = generator.normal(size=(N, 2)), generator.normal(size=motion.variables)
    line = generator.normal(size=4 * LINES * (N + 1))
    values, gradients = motion_row_values(motion, positions, w, np.zeros(4), line)
    # As in the programme: rows of the path come first, slacks stand between places and the rest.
    before = N + 2 * N * LINES - LINES
    jacobian = np.zeros((before + len(values), shape.variables))
    jacobian[before:, : 2 * N] = gradients[:, : 2 * N]
    jacobian[before:, 2 * N + shape.slacks :] = gradients[:, 2 * N :]
    cones = motion_cones(shape)
    assert len(cones) == 2 * N
    pairs = cones.pairs(jacobian)
    by_step = w.reshape(N, 4)
    expected = np.stack([by_step[:, 2:], by_step[:, :2]], axis=1).reshape(-1, 2)
    assert pairs == pytest.approx(expected)
    rows = cones.weight * (pairs**2).sum(axis=1) + cones.constant
    assert rows == pytest.approx(values[cones.row - before])
    radii = cones.radii(np.zeros(before + len(values)))
    assert radii == pytest.approx([DOUBLE.acceleration_max_m_s2, DOUBLE.speed_max_m_s] * N)


def test_others_have_none() -> None:
    """A unicycle's limits are intervals, a single integrator has no rows of motion."""
    wheels = PathShape(N, LINES, "full", motion=MotionShape(WHEELS, 1.0, N, LINES))
    for cones in (no_cones(), motion_cones(wheels), motion_cones(PathShape(N, LINES, "full"))):
        assert len(cones) == 0
        assert cones.pairs(np.zeros((4, 4))).shape == (0, 2)
