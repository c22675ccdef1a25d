"""Sequential convex programming: closed forms, agreement with IPOPT, and how it fails."""

from dataclasses import replace

import numpy as np
import pytest
from reach_tasks import (
    bowl_margins,
    changed,
    constant_margins,
    goal_nlp,
    outage_of,
    reach_task,
    scored,
    slope_margins,
)
from terms_scene import ENERGY, LEARNING, TRACKING, context_of, scorer_of, terms_problem

from planopt import Verdict
from planopt.extend import Termination
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.programme.scp import scp_solve
from planopt.planning.programme.solver import Bounds, NlpFunctions, PathShape
from planopt.planning.refinement import polish_path

N, LINES = 6, 2


@pytest.fixture(scope="module")
def solvers():
    return goal_nlp(N, LINES), goal_nlp(N, LINES, "scp")


def test_the_circle_and_the_line():
    """Min (x - 3)^2 + (y - 2)^2 on the circle of radius 1 about (0, 0), by an equality row.

    The answer is (3, 2) / sqrt(13), with multiplier sqrt(13) - 1.
    """
    functions = NlpFunctions(
        lambda x, _p: float(((x - [3.0, 2.0]) ** 2).sum()),
        lambda x, _p: np.full(2, x @ x),
        lambda x, _p: (2.0 * (x - [3.0, 2.0]), np.tile(2.0 * x, (2, 1))),
        lambda _x, _p, multipliers: 2.0 * np.eye(2) * (1.0 + multipliers.sum()),
    )
    # The first row, the length of the only step, is never at its bound.
    solve = scp_solve(functions, PathShape(1, 0, "stagewise"))
    rows = Bounds(np.array([-np.inf, 1.0]), np.array([4.0, 1.0]))
    free = Bounds(np.full(2, -10.0), np.full(2, 10.0))
    found = solve(np.array([0.1, 0.0]), np.zeros(0), free, rows)
    assert found.termination is Termination.CONVERGED
    np.testing.assert_allclose(
        found.positions_m[0], np.array([3.0, 2.0]) / np.sqrt(13.0), atol=1e-3
    )
    assert found.row_multipliers[1] == pytest.approx(np.sqrt(13.0) - 1.0, rel=5e-3)


@pytest.mark.parametrize("bound_db", [-np.inf, -2.0, 0.5])
def test_it_finds_what_ipopt_finds(solvers, bound_db):
    """Path and multipliers, with the connectivity bound slack and tight."""
    task = reach_task(
        N, LINES, margins=scored(bowl_margins([3.0, 1.5], 4.0)), bound=np.full(N, bound_db)
    )
    by_ipopt, by_scp = (polish_path(nlp, task) for nlp in solvers)
    assert by_scp.termination is Termination.CONVERGED
    np.testing.assert_allclose(by_scp.path_m, by_ipopt.path_m, atol=5e-3)
    for name, expected in by_ipopt.multipliers.items():
        np.testing.assert_allclose(by_scp.multipliers[name], expected, atol=2e-2)
    assert by_scp.kkt_residual < 1e-2


def test_it_finds_what_ipopt_finds_at_a_price_of_outage(solvers):
    """The same where the path is bent by what a metre out of contact costs."""
    task = reach_task(
        N,
        LINES,
        effort_s_m2=0.3,
        step_length_m=3.0,
        margins=scored(constant_margins(10.0), slope_margins([0.2, 0.6], -1.0)),
        outage=outage_of(N, 2.0, 0.4),
        pivot_m=np.array([15.0, 4.0]),
    )
    by_ipopt, by_scp = (polish_path(nlp, task) for nlp in solvers)
    assert by_ipopt.termination is by_scp.termination is Termination.CONVERGED
    np.testing.assert_allclose(by_scp.path_m, by_ipopt.path_m, atol=2e-2)
    free = polish_path(solvers[0], changed(task, outage=outage_of(N)))
    assert np.abs(by_ipopt.path_m - free.path_m).max() > 0.3


def test_rows_that_cannot_be_kept(solvers):
    """A bound above what any place has: infeasible, not converged."""
    task = reach_task(N, LINES, margins=scored(constant_margins(-5.0)), bound=np.zeros(N))
    assert polish_path(solvers[1], task).termination is Termination.INFEASIBLE


def test_no_numbers(solvers):
    """A start or a bound that is no number gives a point of NaN, and the next solve is unharmed."""
    task = reach_task(N, LINES)
    before = polish_path(solvers[1], task)
    for spoilt in (
        replace(task, path_m=np.full((N, 2), np.nan)),
        replace(task, bound=np.full(N, np.nan)),
        changed(task, margins=scored(constant_margins(np.nan)), bound=np.zeros(N)),
    ):
        lost = polish_path(solvers[1], spoilt)
        assert lost.termination is Termination.NUMERICAL_FAILURE
        assert np.isnan(lost.path_m).all()
    after = polish_path(solvers[1], task)
    np.testing.assert_array_equal(after.path_m, before.path_m)


@pytest.mark.parametrize("terms", [(TRACKING,), (LEARNING,), (TRACKING, ENERGY)])
@pytest.mark.parametrize("seed", range(3))
def test_plans_agree_within_one_percent(terms, seed):
    """Both planners, where both are verified, from one lattice start."""
    plans = []
    for name in ("nlp", "scp"):
        problem = terms_problem(*terms, name=name, p_min=0.6)
        context, belief = context_of(problem, seed)
        scorer, ground = scorer_of(context, belief)
        plans.append(HorizonPlanner(problem, ground).plan(context, scorer))
    nlp, scp = plans
    if nlp.verdict is scp.verdict is Verdict.VERIFIED:
        assert scp.objective == pytest.approx(nlp.objective, rel=1e-2)
    assert (scp.verdict is Verdict.VERIFIED) == (nlp.verdict is Verdict.VERIFIED)
