"""The built programme: its rows, its derivatives, its solver."""

import numpy as np
import pytest
from reach_tasks import bowl_margins, constant_margins, scored
from scipy.stats import norm

from planopt.planning.plan import Termination
from planopt.planning.programme.margin_source import MarginSource, StageMargins
from planopt.planning.programme.nlp_functions import Bounds
from planopt.planning.programme.path_callback import PathCallback
from planopt.planning.programme.path_nlp import (
    PIVOT_ROUNDING_M,
    REACH_HEAD,
    STEP_ROUNDING_M,
    build_reach_nlp,
)

N, LINES = 3, 2
ROWS = N + N * LINES + (N - 1) * LINES  # speed, line ends, line starts; then connectivity


def saddle(positions_m):
    """Margins with every second derivative different from zero and from stage to stage."""
    x, y = positions_m.T
    k = np.arange(1.0, len(x) + 1.0)
    return StageMargins(
        k * x**2 * y + y**3 - x,
        np.stack([2.0 * k * x * y - 1.0, k * x**2 + 3.0 * y**2], axis=1),
        np.stack([2.0 * k * y, 2.0 * k * x, 6.0 * y], axis=1),
    )


@pytest.fixture(scope="module")
def nlp():
    """Three steps, two lines a segment."""
    return build_reach_nlp(N, LINES)


def waves(positions_m):
    """Scores about zero, where the probability of connection bends most."""
    x, y = positions_m.T
    k = np.arange(1.0, len(x) + 1.0)
    return StageMargins(
        np.sin(k * x) * np.cos(y),
        np.stack([k * np.cos(k * x) * np.cos(y), -np.sin(k * x) * np.sin(y)], axis=1),
        np.stack(
            [
                -(k**2) * np.sin(k * x) * np.cos(y),
                -k * np.cos(k * x) * np.sin(y),
                -np.sin(k * x) * np.cos(y),
            ],
            axis=1,
        ),
    )


@pytest.fixture
def point(nlp):
    """Random positions and parameters, margins and scores set."""
    generator = np.random.default_rng(4)
    nlp.source.use(scored(saddle, waves))
    x = generator.standard_normal(2 * N)
    head = np.array([0.3, -0.2, 5.0, 4.0, 0.7, 1.3, 0.9, 0.6])
    charged = np.array([1.0, 0.0, 0.8])
    return x, np.concatenate([head, charged, generator.standard_normal(4 * N * LINES)])


def objective(x, p):
    """The docstring's cost in NumPy."""
    q = np.vstack([p[:2], x.reshape(N, 2)])
    to_pivot = np.sqrt(((q[-1] - p[2:4]) ** 2).sum() + PIVOT_ROUNDING_M**2)
    squares = (np.diff(q, axis=0) ** 2).sum(1)
    share = np.append(p[7], p[REACH_HEAD : REACH_HEAD + N] * norm.sf(waves(q[1:]).value))
    lengths = np.sqrt(squares + STEP_ROUNDING_M**2)
    outage = (lengths * (share[:-1] + share[1:]) / 2.0).sum()
    return p[4] * squares.sum() + p[5] * to_pivot + p[6] * outage


def rows(x, p):
    """The docstring's rows in NumPy."""
    q = np.vstack([p[:2], x.reshape(N, 2)])
    lines = p[REACH_HEAD + N :].reshape(N, LINES, 4)
    ends = [n @ q[k + 1] - b for k in range(N) for *n, b, _ in lines[k]]
    starts = [n @ q[k] - b for k in range(1, N) for *n, _, b in lines[k]]
    speed = (np.diff(q, axis=0) ** 2).sum(1)
    return np.concatenate([speed, ends, starts, saddle(q[1:]).value])


def differences(function, x, h=1e-6):
    """Jacobian by central differences."""
    steps = h * np.eye(len(x))
    return np.stack([(function(x + s) - function(x - s)) / (2.0 * h) for s in steps], axis=-1)


def test_cost_and_gradient(nlp, point):
    """What the solver is given is the documented cost and its gradient."""
    x, p = point
    value = nlp.solver.get_function("nlp_f")(x, p)
    _, gradient = nlp.solver.get_function("nlp_grad_f")(x, p)
    assert float(value) == pytest.approx(objective(x, p), rel=1e-12)
    expected = differences(lambda at: objective(at, p), x)
    np.testing.assert_allclose(np.asarray(gradient).ravel(), expected, atol=1e-7)


def test_rows_and_jacobian(nlp, point):
    """The documented rows in the documented order, and their Jacobian."""
    x, p = point
    value = nlp.solver.get_function("nlp_g")(x, p)
    _, jacobian = nlp.solver.get_function("nlp_jac_g")(x, p)
    assert value.numel() == ROWS + N
    np.testing.assert_allclose(np.asarray(value).ravel(), rows(x, p), rtol=1e-12)
    np.testing.assert_allclose(
        np.asarray(jacobian), differences(lambda at: rows(at, p), x), atol=1e-7
    )


def test_hessian_of_the_lagrangian(nlp, point):
    """Upper triangle of the second derivatives, multipliers of either sign."""
    x, p = point
    multipliers = np.random.default_rng(5).standard_normal(ROWS + N)
    triangle = np.asarray(nlp.solver.get_function("nlp_hess_l")(x, p, 1.7, multipliers))

    def gradient(at):
        cost = differences(lambda y: objective(y, p), at, 1e-4)
        return 1.7 * cost + multipliers @ differences(lambda y: rows(y, p), at, 1e-4)

    full = differences(gradient, x, 1e-4)
    np.testing.assert_array_equal(triangle, np.triu(triangle))
    np.testing.assert_allclose(triangle, np.triu(full), atol=1e-5)


def test_stages_see_only_their_own_margin():
    """The three callbacks give values, gradients and Hessians, all margins before all scores."""
    source = MarginSource(2)
    source.use(scored(saddle, waves))
    flat = np.array([0.5, -1.0, 2.0, 3.0])
    margins, scores = saddle(flat.reshape(2, 2)), waves(flat.reshape(2, 2))
    for quantity, width in (("value", 1), ("gradient", 2), ("hessian", 3)):
        callback = PathCallback(
            f"c_{quantity}", 2, 4 * width, lambda at, q=quantity: getattr(source.at(at), q)
        )
        found = np.asarray(callback(flat)).ravel()
        expected = [getattr(rows, quantity).ravel() for rows in (margins, scores)]
        np.testing.assert_array_equal(found, np.concatenate(expected))


def test_at_a_standstill_derivatives_are_numbers(nlp, point):
    """A step of no length: the rounding keeps slope and curvature of the outage finite."""
    _, p = point
    x = np.tile(p[:2], N)
    _, gradient = nlp.solver.get_function("nlp_grad_f")(x, p)
    expected = differences(lambda at: objective(at, p), x)
    np.testing.assert_allclose(np.asarray(gradient).ravel(), expected, atol=1e-6)
    triangle = nlp.solver.get_function("nlp_hess_l")(x, p, 1.0, np.zeros(ROWS + N))
    assert np.isfinite(np.asarray(triangle)).all()


@pytest.mark.parametrize(("horizon", "lines"), [(1, 0), (1, 2), (2, 1), (5, 0)])
def test_every_structure_solves(horizon, lines):
    """One step, no lines: as many variables and multipliers as the structure says."""
    nlp = build_reach_nlp(horizon, lines)
    nlp.source.use(scored(bowl_margins([0.0, 0.0], 100.0)))
    parameters = np.zeros(REACH_HEAD + horizon + 4 * horizon * lines)
    parameters[:REACH_HEAD] = [0.0, 0.0, 9.0, 0.0, 0.1, 1.0, 0.5, 0.0]
    plain = horizon + (2 * horizon - 1) * lines
    lower = np.concatenate([np.full(horizon, -np.inf), np.zeros(plain)])
    upper = np.concatenate([np.ones(horizon), np.full(plain, np.inf)])
    bound = np.full(2 * horizon, 50.0)
    found = nlp.solve(
        np.zeros(2 * horizon), parameters, Bounds(-bound, bound), Bounds(lower, upper)
    )
    assert found.termination == Termination.CONVERGED
    assert found.iterations > 0
    expected = np.outer(np.arange(1, horizon + 1), [1.0, 0.0])
    np.testing.assert_allclose(found.positions_m, expected, atol=1e-4)
    assert found.slack_db.shape == (0,)
    assert found.row_multipliers.shape == (plain + horizon,)
    assert found.variable_multipliers.shape == (2 * horizon,)


def test_two_solvers_do_not_share_margins():
    """Each solver evaluates its own source."""
    one, two = build_reach_nlp(1, 0), build_reach_nlp(1, 0)
    one.source.use(scored(constant_margins(5.0)))
    two.source.use(scored(constant_margins(-5.0)))
    terminations = [
        nlp.solve(
            np.zeros(2),
            np.array([0.0, 0.0, 9.0, 0.0, 0.1, 1.0, 0.5, 0.0, 1.0]),
            Bounds(np.full(2, -9.0), np.full(2, 9.0)),
            Bounds(np.array([-np.inf, 0.0]), np.array([1.0, np.inf])),
        ).termination
        for nlp in (one, two)
    ]
    assert terminations[0] == Termination.CONVERGED
    assert terminations[1] == Termination.INFEASIBLE
