"""The programme over any path value against SciPy, and what its structures have in common."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from planopt.arrays import Derivatives
from planopt.extend import Termination
from planopt.planning.programme.goal_value import Evaluation, PathValue
from planopt.planning.programme.path_nlp import build_path_nlp
from planopt.planning.programme.solver import PathShape
from planopt.planning.refinement import PathTask, polish_path
from planopt.world import empty_lines

N = 4
HILL = np.array([3.0, 1.5])


def no_lines(count=1):
    return empty_lines(N, count)


def one_line():
    """Every segment stays above y = 0.5 (and the clearance)."""
    lines = empty_lines(N, 1)
    lines.normals[:, :, 1] = 1.0
    lines.offsets[:] = lines.start_offsets[:] = 0.5
    lines.gaps[:] = 1.0
    lines.piece[:] = 0
    return lines


def bell(positions, weights):
    """A bell over `HILL` with derivatives, per stage."""
    offset = positions - HILL
    height = weights * np.exp(-0.1 * (offset**2).sum(axis=1))
    gradient = -0.2 * offset * height[:, None]
    xx = height * (0.04 * offset[:, 0] ** 2 - 0.2)
    yy = height * (0.04 * offset[:, 1] ** 2 - 0.2)
    xy = height * 0.04 * offset[:, 0] * offset[:, 1]
    return height, gradient, np.stack([xx, xy, yy], axis=1)


def margins(positions):
    count = len(positions)
    return Derivatives(
        2.0 - positions[:, 0], np.tile([-1.0, 0.0], (count, 1)), np.zeros((count, 3))
    )


PULL = {"stagewise": 0.0, "chain": 0.1, "full": 0.1}
"""What a square metre between neighbouring places costs."""


def pulled(positions, pull):
    """Minus the cost of all squared distances between neighbours, and its gradient."""
    gaps = np.diff(positions, axis=0)
    gradient = np.zeros_like(positions)
    gradient[1:] -= 2.0 * pull * gaps
    gradient[:-1] += 2.0 * pull * gaps
    return -pull * (gaps**2).sum(), gradient


def evaluate(weights, structure, bounded):
    """The sum of bells, less what neighbours pull, as a solver asks for it."""
    pull = PULL[structure]

    def at(positions):
        value, gradient, blocks = bell(positions, weights)
        cost, slope = pulled(positions, pull)
        if structure == "stagewise":
            hessian = blocks
        elif structure == "chain":
            own = blocks.copy()
            own[:, [0, 2]] -= 2.0 * pull * np.array([[1.0], [2.0], [2.0], [1.0]])
            across = np.tile(2.0 * pull * np.eye(2).ravel(), N - 1)
            hessian = np.concatenate([own.ravel(), across])
        else:
            gaps = np.diff(np.eye(N), axis=0)
            hessian = np.kron(-2.0 * pull * gaps.T @ gaps, np.eye(2))
            for k, (xx, xy, yy) in enumerate(blocks):
                hessian[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += [[xx, xy], [xy, yy]]
        return Evaluation(
            PathValue(float(value.sum()) + cost, gradient + slope, hessian),
            margins(positions) if bounded else None,
        )

    return at


def task(weights, structure, bounded, lines, **changes):
    """A task from a path along the x axis."""
    settings = {
        "start_m": np.array([0.0, 0.6]),
        "path_m": np.column_stack([0.3 * np.arange(1, N + 1), np.full(N, 0.7)]),
        "lines": lines,
        "clearance_m": 0.1,
        "step_length_m": 1.0,
        "bounds_m": (-5.0, -5.0, 5.0, 5.0),
        "evaluate": evaluate(weights, structure, bounded),
        "scale": 1.0,
        "bound": np.zeros(N) if bounded else None,
        "slack_limit_db": np.zeros(N) if bounded else None,
    }
    return PathTask(**{**settings, **changes})


def total(positions):
    """A sum over stages that falls to the right, each at a rate of its own."""
    rate = 0.1 * np.arange(1, N + 1)
    each = np.exp(-rate * positions[:, 0])
    gradient, hessian = np.zeros((N, 2)), np.zeros((N, 3))
    gradient[:, 0] = -rate * each
    hessian[:, 0] = rate**2 * each
    return PathValue(float(each.sum()), gradient, hessian)


def summed_task(weights, bound, structure="stagewise", **changes):
    """A task whose sum must reach a bound; a dB is worth a half."""

    def at(positions):
        found = evaluate(weights, structure, False)(positions)
        return replace(found, total=total(positions))

    settings = {"bound": np.array([bound]), "per_db": 0.5, "slack_limit_db": np.zeros(1)}
    return task(weights, structure, False, no_lines(), evaluate=at, **{**settings, **changes})


@pytest.mark.parametrize("structure", ["stagewise", "full"])
@pytest.mark.parametrize("bound", [1.0, 2.9, 3.5])
def test_bounded_sum_is_that_of_scipy(structure, bound):
    """Loose, tight and tighter bounds of one row over all stages."""
    weights = np.array([1.0, 0.5, 2.0, 1.0])
    nlp = build_path_nlp(PathShape(N, 1, structure, False, summed=True))
    found = polish_path(nlp, summed_task(weights, bound, structure))
    _, value = by_scipy(weights, structure, False, None, bound)
    assert found.termination is Termination.CONVERGED
    assert worth(found.path_m, weights, structure) == pytest.approx(value, rel=1e-4)
    assert total(found.path_m).value >= bound - 1e-4
    assert found.kkt_residual < 1e-3
    assert found.multipliers["connectivity"].shape == (1,)


def test_slack_of_a_sum_is_bounded_and_priced():
    """As much as is allowed where it is cheap, none where it is dear."""
    weights = np.array([1.0, 0.5, 2.0, 1.0])
    nlp = build_path_nlp(PathShape(N, 1, "stagewise", False, summed=True))
    for price, slack_db in ((1e-3, 0.4), (1e3, 0.0)):
        soft = {"slack_limit_db": np.array([0.4]), "slack_weight": price}
        found = polish_path(nlp, summed_task(weights, 3.5, **soft))
        assert found.slack_db == pytest.approx([slack_db], abs=1e-3)
        assert total(found.path_m).value == pytest.approx(3.5 - 0.5 * slack_db, abs=1e-3)
        assert found.kkt_residual < 1e-2


def worth(path, weights, structure):
    """The value of a path."""
    return bell(path, weights)[0].sum() + pulled(path, PULL[structure])[0]


def by_scipy(weights, structure, bounded, floor, least=None):
    """The best path and its value; `least` is the bound of a sum."""
    start = np.array([0.0, 0.6])

    def steps(x):
        return np.diff(np.vstack([start, x.reshape(N, 2)]), axis=0)

    limits = [{"type": "ineq", "fun": lambda x: 1.0 - (steps(x) ** 2).sum(axis=1)}]
    if floor is not None:
        limits.append({"type": "ineq", "fun": lambda x: x[1::2] - floor})
    if bounded:
        limits.append({"type": "ineq", "fun": lambda x: 2.0 - x[0::2]})
    if least is not None:
        limits.append({"type": "ineq", "fun": lambda x: total(x.reshape(N, 2)).value - least})
    pull = PULL[structure]
    x0 = task(weights, structure, False, no_lines()).path_m.ravel()
    found = minimize(
        lambda x: -worth(x.reshape(N, 2), weights, structure),
        x0,
        jac=lambda x: (
            -(bell(x.reshape(N, 2), weights)[1] + pulled(x.reshape(N, 2), pull)[1]).ravel()
        ),
        constraints=limits,
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 300},
    )
    return found.x.reshape(N, 2), -found.fun


@pytest.mark.parametrize("structure", ["stagewise", "chain", "full"])
@pytest.mark.parametrize("bounded", [True, False])
@pytest.mark.parametrize("floor", [None, 0.601])
def test_optimum_is_that_of_scipy(structure, bounded, floor):
    """With and without bound, line and block structure: one optimum, no residual."""
    weights = np.array([1.0, 0.5, 2.0, 1.0])
    lines = no_lines() if floor is None else one_line()
    nlp = build_path_nlp(PathShape(N, 1, structure, bounded))
    found = polish_path(nlp, task(weights, structure, bounded, lines))
    path, value = by_scipy(weights, structure, bounded, floor)
    assert found.termination is Termination.CONVERGED
    # The solver stops at a tolerance of 1e-4.
    assert worth(found.path_m, weights, structure) == pytest.approx(value, rel=1e-4)
    np.testing.assert_allclose(found.path_m, path, atol=5e-3)
    assert found.kkt_residual < 1e-3
    assert ("connectivity" in found.multipliers) == bounded


def test_a_bound_out_of_reach_is_missed_by_the_least():
    """With slack the missing dB are paid for, and told."""
    weights = np.ones(N)
    nlp = build_path_nlp(PathShape(N, 1, "stagewise", True))
    far = task(
        weights,
        "stagewise",
        True,
        no_lines(),
        bound=np.full(N, 3.5),
        slack_limit_db=np.full(N, np.inf),
        slack_weight=100.0,
    )
    found = polish_path(nlp, far)
    assert found.termination is Termination.CONVERGED
    # As far to the left as the speed allows: x = -1, -1.5, -1.5, -1.5.
    np.testing.assert_allclose(found.slack_db, [0.5, 0.0, 0.0, 0.0], atol=1e-3)
