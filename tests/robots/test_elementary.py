"""sin(z)/z without branches, for arrays and CasADi alike."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from planopt.robots.models import sinc


def test_sinc_is_numpys() -> None:
    """To round-off over a half turn to either side, zero and tiny angles included."""
    angle = np.concatenate([np.linspace(-np.pi, np.pi, 2001), [0.0, 1e-300, 1e-9, -1e-5]])
    assert sinc(angle) == pytest.approx(np.sinc(angle / np.pi), abs=4e-15)


def test_derivative_at_zero() -> None:
    """CasADi's derivative of it is finite at zero, where sin(z)/z has none as it is written."""
    z = ca.SX.sym("z")
    both = ca.Function("both", [z], [ca.jacobian(sinc(z), z), ca.hessian(sinc(z), z)[0]])
    slope, curvature = both(0.0)
    assert float(slope) == 0.0
    assert float(curvature) == pytest.approx(-1.0 / 3.0, abs=1e-14)
