"""The first-order residual on quadratic programmes built from multipliers chosen beforehand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planopt.planning.programme.solver import Bounds, kkt_residual


def residual(case):
    """Residual of the programme and point in `case`."""
    return kkt_residual(
        case.hessian @ case.x + case.linear,
        case.jacobian,
        case.jacobian @ case.x,
        case.row_bounds,
        case.lam_rows,
        case.x,
        case.x_bounds,
        case.lam_x,
    )


def programme(seed=0):
    """A convex QP whose solution and multipliers are chosen, and the linear cost made to fit.

    Rows: at the upper bound (+2), at the lower bound (-3), between (0), equality (-1.5), with no
    bound at all (0). Variables: free, at the lower bound (-4), at the upper bound (+0.5), fixed
    (any), unbounded below and slack above (0).
    """
    generator = np.random.default_rng(seed)
    root = generator.standard_normal((5, 5))
    case = SimpleNamespace(
        hessian=root @ root.T + np.eye(5),
        jacobian=generator.standard_normal((5, 5)),
        x=generator.standard_normal(5),
        lam_rows=np.array([2.0, -3.0, 0.0, -1.5, 0.0]),
        lam_x=np.array([0.0, -4.0, 0.5, 7.0, 0.0]),
    )
    rows = case.jacobian @ case.x
    case.row_bounds = Bounds(
        np.array([-np.inf, rows[1], rows[2] - 1.0, rows[3], -np.inf]),
        np.array([rows[0], rows[1] + 2.0, rows[2] + 1.0, rows[3], np.inf]),
    )
    case.x_bounds = Bounds(
        np.array([-np.inf, case.x[1], case.x[2] - 1.0, case.x[3], -np.inf]),
        np.array([np.inf, np.inf, case.x[2], case.x[3], case.x[4] + 3.0]),
    )
    case.linear = -case.hessian @ case.x - case.jacobian.T @ case.lam_rows - case.lam_x
    # The fixed variable's stationarity holds with another multiplier: it must not matter.
    case.linear[3] += 11.0
    return case


@pytest.mark.parametrize("seed", range(5))
def test_a_solution_has_no_residual(seed):
    """Every kind of row and variable at its solution, the fixed variable's multiplier free."""
    assert residual(programme(seed)) < 1e-12


@pytest.mark.parametrize("row", [0, 1, 3])
def test_a_flipped_sign_of_a_row_shows(row):
    """Against the stated sign convention the stationarity fails by twice the multiplier."""
    case = programme()
    case.lam_rows[row] *= -1.0
    expected = 2.0 * abs(case.lam_rows[row]) * np.abs(case.jacobian[row, [0, 1, 2, 4]]).max()
    assert residual(case) >= expected * (1.0 - 1e-12) > 0.1


def fit_cost(case):
    """Make the cost fit, so that stationarity holds and only the other parts can object."""
    case.linear = -case.hessian @ case.x - case.jacobian.T @ case.lam_rows - case.lam_x


@pytest.mark.parametrize(
    ("row", "multiplier", "expected"),
    [
        (0, -2.0, 2.0),  # pulls at a lower bound that does not exist
        (1, 3.0, 6.0),  # pushes against the upper bound 2 away
        (2, 0.25, 0.25),  # bounds are 1 away on either side
        (2, -0.25, 0.25),
        (4, 0.5, 0.5),  # no bound at all
        (4, -0.5, 0.5),
        (3, 99.0, 0.0),  # an equality takes either sign
        (3, -99.0, 0.0),
    ],
)
def test_a_row_multiplier_of_the_wrong_sign_shows_although_stationarity_holds(
    row, multiplier, expected
):
    """Complementarity is the multiplier times the distance to the bound that it pushes against."""
    case = programme()
    case.lam_rows[row] = multiplier
    fit_cost(case)
    assert residual(case) == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize(
    ("kind", "index", "side", "change"),
    [
        ("row_bounds", 0, "upper", -0.3),
        ("row_bounds", 2, "lower", 1.3),
        ("row_bounds", 2, "upper", -1.3),
        ("x_bounds", 4, "upper", -3.3),
        ("x_bounds", 2, "lower", 1.3),
    ],
)
def test_a_violated_bound_shows_by_how_much(kind, index, side, change):
    """Primal violation counts unscaled; multipliers of the bound are set aside."""
    case = programme()
    case.lam_rows[:], case.lam_x[:] = 0.0, 0.0
    fit_cost(case)
    assert residual(case) < 1e-12
    bounds = getattr(case, kind)
    moved = getattr(bounds, side).copy()
    moved[index] += change
    setattr(case, kind, replace(bounds, **{side: moved}))
    assert residual(case) == pytest.approx(0.3)


@settings(deadline=None)
@given(st.integers(0, 1000), st.floats(1e-4, 10.0), st.integers(0, 3))
def test_a_perturbed_multiplier_shows(seed, size, row):
    """Whatever the programme, a perturbed multiplier moves the residual off zero."""
    case = programme(seed)
    case.lam_rows[row] += size
    assert residual(case) >= size * np.abs(case.jacobian[row, [0, 1, 2, 4]]).max() * 0.999 - 1e-9


@pytest.mark.parametrize("where", ["linear", "lam_rows", "lam_x", "x", "jacobian"])
def test_not_a_number_is_no_small_residual(where):
    """A NaN anywhere makes the residual infinite, wherever the largest part stands."""
    case = programme()
    getattr(case, where)[0] = np.nan
    assert residual(case) == np.inf
