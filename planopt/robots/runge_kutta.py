"""The classic Runge-Kutta method of fourth order, for anything that adds and scales.

Components may be NumPy numbers, NumPy arrays or CasADi expressions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from planopt.robots.dynamics import Components

Derivative = Callable[[Components, Components], Components]
"""From state and input to how fast each component of the state changes, per second."""


def runge_kutta(
    derivative: Derivative, state: Components, control: Components, step_s: float, substeps: int
) -> list[Components]:
    """The states after each of `substeps` equal parts of a step of constant input.

    Parameters
    ----------
    derivative
        The continuous model.
    state, control
        At the start of the step.
    step_s
        Duration of the whole step.
    substeps
        How many parts; the error falls with their fourth power.
    """
    part = step_s / substeps
    found: list[Components] = []
    for _ in range(substeps):
        first = derivative(state, control)
        second = derivative(_moved(state, first, 0.5 * part), control)
        third = derivative(_moved(state, second, 0.5 * part), control)
        fourth = derivative(_moved(state, third, part), control)
        slope: Any = tuple(
            (a + 2.0 * b + 2.0 * c + d) / 6.0
            for a, b, c, d in zip(first, second, third, fourth, strict=True)
        )
        state = _moved(state, slope, part)
        found.append(state)
    return found


def _moved(state: Components, slope: Components, duration_s: float) -> Components:
    return tuple(x + duration_s * dx for x, dx in zip(state, slope, strict=True))
