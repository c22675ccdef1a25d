"""What happens when the solver fails: the next rung, the right words, and no trace of it after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scenes import (
    CUP,
    WALL,
    bad_disc,
    bad_everywhere,
    belief_of,
    small_problem,
)

import planopt.planning.refinement as refine_module
from planopt.planning.plan import Plan, Rung, Termination, Verdict
from planopt.planning.programme import path_nlp
from planopt.planning.programme.path_nlp import GOAL
from planopt.planning.programme.solver import NlpPoint
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene

CALL = path_nlp.call_nlp


def falling_back(status, change):
    """A solver that reports a status and changes the places that it found."""

    def call(solver, horizon, start, parameters, variable_bounds, row_bounds):
        point = CALL(solver, horizon, start, parameters, variable_bounds, row_bounds)
        return replace(point, positions_m=change(point.positions_m), termination=status)

    return call


def not_numbers(_solver, n, _start, _parameters, _variable_bounds, row_bounds):
    """What a solver leaves after an evaluation error."""
    rows = len(row_bounds.lower)
    return NlpPoint(
        np.full((n, 2), np.nan),
        np.full(n, np.nan),
        np.full(rows, np.nan),
        np.full(3 * n, np.nan),
        Termination.NUMERICAL_FAILURE,
        3,
    )


def in_zigzag(positions_m):
    """30 m to and fro."""
    return positions_m + 15.0 * (-1.0) ** np.arange(len(positions_m))[:, None]


# Name: (solver, how the step's termination is reported).
FAILURES = {
    "no numbers": (not_numbers, Termination.NUMERICAL_FAILURE),
    "wild points": (falling_back(Termination.CONVERGED, in_zigzag), Termination.CONVERGED),
    "into the wall": (
        falling_back(Termination.CONVERGED, lambda q: q * (1.0, 0.0) + (0.0, 15.0)),
        Termination.CONVERGED,
    ),
    "out of the workspace": (
        falling_back(Termination.CONVERGED, lambda q: q + (0.0, 40.0)),
        Termination.CONVERGED,
    ),
    "out of time": (
        falling_back(Termination.TIME_LIMIT, lambda q: q + 3.0),
        Termination.TIME_LIMIT,
    ),
    "infeasible": (
        falling_back(Termination.INFEASIBLE, lambda q: 0.0 * q),
        Termination.INFEASIBLE,
    ),
    "out of iterations": (
        falling_back(Termination.ITERATION_LIMIT, in_zigzag),
        Termination.ITERATION_LIMIT,
    ),
}

PROBLEM = small_problem(WALL, start_m=(17.0, 15.0), horizon=8)


@pytest.fixture(params=FAILURES)
def failure(request, monkeypatch):
    """One of the failures, in force; its termination."""
    solver, termination = FAILURES[request.param]
    monkeypatch.setattr(path_nlp, "call_nlp", solver)
    return termination


def assert_safe(problem, plan: Plan) -> None:
    """Clear of obstacles along the whole way, within bounds, not too fast; no number missing."""
    assert np.isfinite(plan.positions_m).all()
    lengths = np.linalg.norm(np.diff(plan.positions_m, axis=0), axis=1)
    assert lengths.max() <= problem.step_length_m + 1e-5
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    assert (plan.positions_m >= (x_min, y_min)).all()
    assert (plan.positions_m <= (x_max, y_max)).all()
    for obstacle in problem.workspace.obstacles:
        way = shapely.LineString(plan.positions_m)
        assert way.distance(obstacle.polygon) >= problem.constraints.clearance_m - 1e-6


def planner_of(problem) -> ReachPlanner:
    """A new planner in a new scene."""
    return ReachPlanner(problem, build_scene(problem))


def test_lattice_is_released(failure):
    """A failed polish costs the polish, not the plan: the lattice path is verified by itself."""
    plan = planner_of(PROBLEM).plan(belief_of(PROBLEM), np.array([17.0, 15.0]))
    assert_safe(PROBLEM, plan)
    assert plan.rung is Rung.LATTICE
    assert plan.verdict is Verdict.VERIFIED
    assert plan.termination is failure
    assert plan.objective == plan.lattice_objective


def test_next_step_is_as_if_nothing_had_happened(monkeypatch):
    """The same planner, once the solver works again, plans bit for bit what a new one does."""
    belief, start = belief_of(PROBLEM), np.array([17.0, 15.0])
    fresh = planner_of(PROBLEM).plan(belief, start)
    used = planner_of(PROBLEM)
    for solver, _ in FAILURES.values():
        monkeypatch.setattr(path_nlp, "call_nlp", solver)
        used.plan(belief, start)
    monkeypatch.undo()
    again = used.plan(belief, start)
    assert again.rung is Rung.PLAN
    assert (again.positions_m == fresh.positions_m).all()
    assert again.objective == fresh.objective < fresh.lattice_objective


def test_real_evaluation_error(monkeypatch):
    """NaN margins inside IPOPT itself: it gives up, the fallbacks do not."""
    margins_of = refine_module.margins_of

    def broken(*arguments):
        margins = margins_of(*arguments)
        return replace(margins, value=margins.value * np.nan)

    planner, belief = planner_of(PROBLEM), belief_of(PROBLEM)
    monkeypatch.setattr(refine_module, "margins_of", broken)
    plan = planner.plan(belief, np.array([17.0, 15.0]))
    assert_safe(PROBLEM, plan)
    assert plan.verdict is Verdict.VERIFIED
    assert plan.rung is Rung.LATTICE
    monkeypatch.undo()
    assert planner.plan(belief, np.array([17.0, 15.0])).rung is Rung.PLAN


def test_real_iteration_limit(monkeypatch):
    """Two iterations are too few: what is released is verified and no worse than the lattice."""
    monkeypatch.setitem(GOAL, "ipopt.max_iter", 1)
    problem = small_problem(CUP, start_m=(18.0, 15.0), horizon=12)
    plan = planner_of(problem).plan(belief_of(problem), np.array([18.0, 15.0]))
    assert_safe(problem, plan)
    assert plan.verdict is Verdict.VERIFIED
    assert plan.objective <= plan.lattice_objective


def test_failure_below_the_bound(failure):
    """From a hole in the bound the lattice's own way out is released as relaxed."""
    problem = small_problem(horizon=6)
    plan = planner_of(problem).plan(
        belief_of(problem, bad_disc(5.0, 15.0, 3.5)), np.array([5.0, 15.0])
    )
    assert_safe(problem, plan)
    assert plan.rung is Rung.RELAXED
    assert plan.verdict is Verdict.VERIFIED
    assert plan.certificate.relaxed_steps == (1,)
    assert "step" in plan.message and "dB" in plan.message


def test_failure_where_the_bound_is_met_nowhere(failure):
    """Nothing is verified, nothing unsafe is released, and the message has its number."""
    problem = small_problem(WALL, start_m=(17.0, 15.0), horizon=8)
    plan = planner_of(problem).plan(belief_of(problem, bad_everywhere), np.array([17.0, 15.0]))
    assert_safe(problem, plan)
    assert plan.verdict is Verdict.VIOLATED
    assert "met nowhere" in plan.message and "dB" in plan.message


def without_lattice(planner: ReachPlanner, monkeypatch) -> None:
    """No node is in reach any more."""
    monkeypatch.setattr(planner._search, "find_start", lambda *_: None)


def test_shifted_plan(monkeypatch):
    """With no start path at all the last verified plan goes on, less its first step."""
    planner, belief = planner_of(PROBLEM), belief_of(PROBLEM)
    first = planner.plan(belief, np.array([17.0, 15.0]))
    without_lattice(planner, monkeypatch)
    second = planner.plan(belief, first.positions_m[1], first)
    assert second.rung is Rung.SHIFTED
    assert second.verdict is Verdict.VERIFIED
    assert second.termination is Termination.STOPPED
    assert (second.positions_m[:-1] == first.positions_m[1:]).all()
    assert (second.positions_m[-1] == first.positions_m[-1]).all()
    assert_safe(PROBLEM, second)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda plan: replace(plan, verdict=Verdict.VIOLATED),
        lambda plan: replace(plan, positions_m=plan.positions_m + 3.0),
        lambda plan: replace(plan, positions_m=plan.positions_m[:-2]),
        lambda plan: None,
    ],
)
def test_stop(monkeypatch, spoil):
    """A last plan that was not verified, or is not now, or is of another length: stand still."""
    planner, belief = planner_of(PROBLEM), belief_of(PROBLEM)
    first = planner.plan(belief, np.array([17.0, 15.0]))
    without_lattice(planner, monkeypatch)
    plan = planner.plan(belief, first.positions_m[1], spoil(first))
    assert plan.rung is Rung.STOP
    assert plan.termination is Termination.NO_PATH
    assert (plan.positions_m == first.positions_m[1]).all()
    assert "stands still" in plan.message


def test_shifted_plan_is_checked_on_todays_map(monkeypatch):
    """What was verified before a place ahead turned out to be below the bound is not any more."""
    planner = planner_of(PROBLEM)
    first = planner.plan(belief_of(PROBLEM), np.array([17.0, 15.0]))
    without_lattice(planner, monkeypatch)
    ahead = first.positions_m[4]
    today = belief_of(PROBLEM, bad_disc(*ahead, 3.0))
    plan = planner.plan(today, first.positions_m[1], first)
    assert plan.rung is Rung.STOP
