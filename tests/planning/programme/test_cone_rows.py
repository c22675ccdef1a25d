"""Rows that are cones: what they say is what the built programme computes."""

from __future__ import annotations

import numpy as np
import pytest
from motion_scene import DOUBLE, WHEELS
from reach_tasks import constant_margins

from planopt.planning.programme.goal_value import Evaluation, PathValue
from planopt.planning.programme.path_nlp import build_path_nlp
from planopt.planning.programme.path_rows import MotionShape, PathShape
from planopt.planning.programme.scp import motion_cones, step_cones

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
    x = generator.normal(size=shape.variables)
    nlp = build_path_nlp(shape)
    line, own = np.zeros(4 * N * LINES), np.zeros(motion.parameters)
    parameters = np.concatenate([np.zeros(2), np.ones(3), line, own])
    nlp.source.use(
        lambda places: Evaluation(
            PathValue(0.0, np.zeros((N, 2)), np.zeros((N, 3))),
            constant_margins(1.0)(places) if bounded else None,
        )
    )
    values = nlp.functions.values(x, parameters)[1]
    jacobian = nlp.functions.slopes(x, parameters)[1]
    cones = motion_cones(shape)
    assert len(cones) == 2 * N
    pairs = cones.pairs(jacobian)
    by_step = x[2 * N + shape.slacks :].reshape(N, 4)
    expected = np.stack([by_step[:, 2:], by_step[:, :2]], axis=1).reshape(-1, 2)
    assert pairs == pytest.approx(expected)
    rows = cones.weight * (pairs**2).sum(axis=1) + cones.constant
    assert rows == pytest.approx(values[cones.row])
    radii = cones.radii(np.zeros(len(values)))
    assert radii == pytest.approx([DOUBLE.acceleration_max_m_s2, DOUBLE.speed_max_m_s] * N)


def test_others_have_none() -> None:
    """A unicycle's limits are intervals."""
    wheels = PathShape(N, LINES, "full", motion=MotionShape(WHEELS, 1.0, N, LINES))
    assert len(motion_cones(wheels)) == 0
