"""Runge-Kutta: order four, and one formula for NumPy and CasADi."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from planopt.robots.casadi_map import runge_kutta
from planopt.robots.models import Unicycle, cosine, sine


def wheels(state, control):
    """The unicycle as a differential equation."""
    return (control[0] * cosine(state[2]), control[0] * sine(state[2]), control[1])


def test_error_falls_with_the_fourth_power() -> None:
    """Against the exact arc, halving the parts divides the error by about 16."""
    state, control = (0.3, -0.2, 0.7), (2.0, 1.9)
    exact = np.array(Unicycle(3.0, 2.0).step(state, control, 1.0))
    errors = [
        np.linalg.norm(np.array(runge_kutta(wheels, state, control, 1.0, n)[-1]) - exact)
        for n in (4, 8, 16, 32)
    ]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx([4.0, 4.0, 4.0], abs=0.1)


def test_numpy_and_casadi_agree() -> None:
    """To 1e-12, single numbers and arrays alike."""
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 2)
    state, control = tuple(ca.vertsplit(x)), tuple(ca.vertsplit(u))
    symbolic = ca.Function(
        "rk", [x, u], [ca.vertcat(*runge_kutta(wheels, state, control, 0.5, 3)[-1])]
    )
    states = np.random.default_rng(0).normal(size=(5, 3))
    batch = runge_kutta(wheels, tuple(states.T), (np.full(5, 1.5), np.full(5, -0.4)), 0.5, 3)[-1]
    for number, one in enumerate(states):
        expected = np.array(symbolic(one, [1.5, -0.4])).ravel()
        assert [column[number] for column in batch] == pytest.approx(expected, abs=1e-12)
