"""A convex step against the same programme written in CVXPY, and Clarabel's statuses."""

import clarabel
import cvxpy as cp
import numpy as np
import pytest

from planopt.extend import Termination
from planopt.planning.programme.scp import TERMINATIONS, Model, convex_step, step_cones
from planopt.planning.programme.solver import Bounds

N, OTHER, SLACKS = 4, 6, 2
LONGEST = 1.5


def random_model(seed, missing):
    """Four stages and two more variables; rows of all kinds, some of them missed if `missing`."""
    generator = np.random.default_rng(seed)
    n = 2 * N + SLACKS
    path = np.vstack([np.zeros(2), np.cumsum(generator.uniform(-0.7, 0.7, (N, 2)), axis=0)])
    steps = np.diff(path, axis=0)
    jacobian = np.zeros((N + OTHER, n))
    for k in range(N):
        jacobian[k, 2 * k : 2 * k + 2] = 2.0 * steps[k]
        if k:
            jacobian[k, 2 * k - 2 : 2 * k] = -2.0 * steps[k]
    jacobian[N:] = generator.standard_normal((OTHER, n))
    rows = np.concatenate([(steps**2).sum(1), generator.standard_normal(OTHER)])
    lower, upper = np.full(N + OTHER, -np.inf), np.full(N + OTHER, np.inf)
    upper[:N] = LONGEST**2
    room = np.array([0.2, 0.1, 0.3, 0.4, 0.0, 0.1]) - (0.6 if missing else 0.0)
    lower[N : N + 2] = rows[N : N + 2] - room[:2]
    upper[N + 2 : N + 4] = rows[N + 2 : N + 4] + room[2:4]
    lower[N + 4] = upper[N + 4] = rows[N + 4] + room[4]
    lower[N + 5], upper[N + 5] = rows[N + 5] - 0.1, rows[N + 5] + 0.2
    root = generator.standard_normal((n, n))
    highest = np.full(n, 0.8)
    lowest = -highest
    lowest[-1] = highest[-1] = 0.0  # a variable that is set
    highest[-2] = np.inf
    return Model(
        rows=rows,
        jacobian=jacobian,
        gradient=5.0 * generator.standard_normal(n),
        curvature=0.1 * root @ root.T,
        row_bounds=Bounds(lower, upper),
        cones=step_cones(N),
        lowest=lowest,
        highest=highest,
        penalty=20.0,
    ), path


def in_cvxpy(model, path):
    d = cp.Variable(len(model.gradient))
    t = cp.Variable(len(model.rows) - N, nonneg=True)
    rows = model.rows[N:] + model.jacobian[N:] @ d
    lower, upper = model.row_bounds.lower[N:], model.row_bounds.upper[N:]
    kept = (lower <= model.rows[N:]) & (model.rows[N:] <= upper)
    at_least, at_most = np.isfinite(lower), np.isfinite(upper)
    steps = np.diff(path, axis=0)
    moved = [d[2 * k : 2 * k + 2] - (d[2 * k - 2 : 2 * k] if k else 0.0) for k in range(N)]
    bounded = np.isfinite(model.highest)
    problem = cp.Problem(
        cp.Minimize(
            model.gradient @ d
            + 0.5 * cp.quad_form(d, cp.psd_wrap(model.curvature))
            + model.penalty * cp.sum(t)
        ),
        [
            rows[at_least] + t[at_least] >= lower[at_least],
            rows[at_most] - t[at_most] <= upper[at_most],
            *[cp.norm(steps[k] + moved[k]) <= LONGEST for k in range(N)],
            t[kept] == 0.0,
            d >= model.lowest,
            d[bounded] <= model.highest[bounded],
        ],
    )
    problem.solve(solver=cp.CLARABEL)
    return d.value, problem.value


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_it_is_the_programme_of_the_docstring(seed, missing):
    """Same step, and multipliers that make the Lagrangian stationary."""
    model, path = random_model(seed, missing)
    found = convex_step(model)
    expected, _ = in_cvxpy(model, path)
    assert found.termination is Termination.CONVERGED
    np.testing.assert_allclose(found.step, expected, atol=1e-4)
    # The first rows are kept as |u|^2 <= L^2 at the new place, where they are not linearised.
    steps = np.diff(path + np.vstack([np.zeros(2), found.step[: 2 * N].reshape(N, 2)]), axis=0)
    jacobian = model.jacobian.copy()
    for k in range(N):
        jacobian[k, 2 * k : 2 * k + 2] = 2.0 * steps[k]
        if k:
            jacobian[k, 2 * k - 2 : 2 * k] = -2.0 * steps[k]
    moving = model.lowest < model.highest
    stationary = (
        model.gradient
        + model.curvature @ found.step
        + jacobian.T @ found.row_multipliers
        + found.variable_multipliers
    )
    np.testing.assert_allclose(stationary[moving], 0.0, atol=2e-4)


@pytest.mark.parametrize("name", [n for n in dir(clarabel.SolverStatus) if n[0].isupper()])
def test_every_status_has_a_meaning(name):
    """Of all that Clarabel can say; only solved counts as converged."""
    status = str(getattr(clarabel.SolverStatus, name))
    assert (TERMINATIONS[status] is Termination.CONVERGED) == (status == "Solved")
