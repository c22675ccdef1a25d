# pyright: basic
"""A CasADi function for components of any kind: expressions, numbers, arrays, real or complex."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from planopt.robots.dynamics import Components


class ComponentFunction:
    """A function of (state, input), called with the components of both.

    Parameters
    ----------
    function
        A ``casadi.Function`` of two column vectors. Its directional derivative stands for the
        imaginary part, to first order: that is what complex differentiation needs.
    """

    def __init__(self, function: Any) -> None:
        self._function = function
        self._states = function.size1_in(0)
        self._results = function.size1_out(0)
        x, u, dx, du = (
            ca.SX.sym(name, function.size1_in(at))
            for name, at in (("x", 0), ("u", 1), ("dx", 0), ("du", 1))
        )
        slope = ca.jtimes(function(x, u), ca.vertcat(x, u), ca.vertcat(dx, du))
        self._directional = ca.Function("directional", [x, u, dx, du], [slope])

    def __call__(self, state: Components, control: Components) -> Components:
        """Return the function's components, of the kind and shape of those given, also if empty."""
        if any(isinstance(value, ca.SX | ca.MX) for value in (*state, *control)):
            return tuple(ca.vertsplit(self._function(ca.vertcat(*state), ca.vertcat(*control))))
        both = np.broadcast_arrays(*(np.asarray(value) for value in (*state, *control)))
        shape, table = both[0].shape, np.array([value.ravel() for value in both])
        if table.size == 0:  # CasADi takes no columns for one column
            return tuple(np.zeros(shape, dtype=table.dtype) for _ in range(self._results))
        split = self._states
        real = np.ascontiguousarray(np.real(table))
        value = np.array(self._function(real[:split], real[split:]))
        if np.iscomplexobj(table):
            step = np.ascontiguousarray(np.imag(table))
            slope = self._directional(real[:split], real[split:], step[:split], step[split:])
            value = value + 1j * np.array(slope)
        return tuple(row.reshape(shape) for row in value)
