"""A sum of terms when the solver fails, or the map changes: the next rung, and no trace after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from terms_scene import ENERGY, LEARNING, TRACKING, judge_of, situation_of, terms_problem

from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.plan import Plan, Rung, Termination, Verdict
from planopt.planning.programme import path_nlp
from planopt.planning.programme.solver import NlpPoint
from planopt.world.workspace import Obstacle

CALL = path_nlp.call_nlp
PROBLEM = terms_problem(TRACKING, LEARNING, ENERGY, p_min=0.6)


def with_status(status, change):
    """A solver that reports a status and changes the places that it found."""

    def call(*arguments):
        point = CALL(*arguments)
        return replace(point, positions_m=change(point.positions_m), termination=status)

    return call


def no_numbers(_solver, n, start, _parameters, _variable_bounds, row_bounds):
    """What a solver leaves after an evaluation error."""
    slacks = np.full(len(start) - 2 * n, np.nan)
    rows = np.full(len(row_bounds.lower), np.nan)
    lost = np.full(len(start), np.nan)
    return NlpPoint(np.full((n, 2), np.nan), slacks, rows, lost, Termination.NUMERICAL_FAILURE, 3)


FAILURES = {
    "no numbers": (no_numbers, Termination.NUMERICAL_FAILURE),
    "infeasible": (
        with_status(Termination.INFEASIBLE, lambda q: 0.0 * q),
        Termination.INFEASIBLE,
    ),
    "out of time": (
        with_status(Termination.TIME_LIMIT, lambda q: q + 3.0),
        Termination.TIME_LIMIT,
    ),
    "out of iterations": (
        with_status(Termination.ITERATION_LIMIT, lambda q: q[::-1]),
        Termination.ITERATION_LIMIT,
    ),
    "through the obstacle": (
        with_status(Termination.CONVERGED, lambda q: 0.0 * q + (20.0, 20.0)),
        Termination.CONVERGED,
    ),
}


def planned(planner: HorizonPlanner, warm: Plan | None = None, problem=PROBLEM) -> Plan:
    """A plan from the start of the problem, of a situation that has seen nothing yet."""
    situation, belief = situation_of(problem)
    return planner.plan(situation, judge_of(situation, belief)[0], warm)


def fresh(problem=PROBLEM) -> HorizonPlanner:
    """A planner that has not planned."""
    situation, belief = situation_of(problem)
    return HorizonPlanner(problem, judge_of(situation, belief)[1])


def assert_same(plan: Plan, other: Plan) -> None:
    """To the last digit."""
    np.testing.assert_array_equal(plan.positions_m, other.positions_m)
    assert (plan.objective, plan.rung, plan.termination, plan.verdict) == (
        other.objective,
        other.rung,
        other.termination,
        other.verdict,
    )


def assert_sound(plan: Plan, problem=PROBLEM) -> None:
    """Verified, and clear of obstacles by GEOS alone."""
    assert plan.verdict is Verdict.VERIFIED
    way = shapely.LineString(plan.positions_m)
    for obstacle in problem.workspace.obstacles:
        assert way.distance(obstacle.polygon) >= problem.constraints.clearance_m - 1e-6


@pytest.mark.parametrize("name", FAILURES)
def test_a_failed_solve_touches_nothing(name, monkeypatch):
    """A verified plan of a lower rung, its reason in it; the next plan is a fresh planner's."""
    solver, termination = FAILURES[name]
    used, expected = fresh(), planned(fresh())
    assert expected.rung is Rung.PLAN
    monkeypatch.setattr(path_nlp, "call_nlp", solver)
    plan = planned(used)
    assert_sound(plan)
    assert plan.rung is Rung.LATTICE
    assert plan.termination is termination
    assert plan.objective < expected.objective
    monkeypatch.undo()
    assert_same(planned(used), expected)


def test_a_bound_that_nothing_meets_is_said(monkeypatch):
    """An impossible threshold: violated, with its number; the next plan is a fresh planner's."""
    station = replace(PROBLEM.stations[0], threshold_dbm=50.0)
    problem = replace(PROBLEM, stations=(station,))
    planner = fresh(problem)
    plan = planned(planner, problem=problem)
    assert plan.verdict is Verdict.VIOLATED
    assert f"none of the {problem.planner.horizon} steps" in plan.message
    assert plan.certificate.min_clearance_m >= problem.constraints.clearance_m - 1e-6
    assert_same(planned(planner, problem=problem), planned(fresh(problem), problem=problem))


def test_an_obstacle_on_the_last_plan():
    """The map changes between two steps: the last plan is not driven on, nor started from."""
    last = planned(fresh())
    middle = 0.5 * (last.positions_m[2] + last.positions_m[3])
    wall = Obstacle("new", shapely.Point(middle).buffer(0.2))
    now = replace(
        PROBLEM,
        workspace=replace(PROBLEM.workspace, obstacles=(*PROBLEM.workspace.obstacles, wall)),
        robots=(replace(PROBLEM.robots[0], start_m=tuple(last.positions_m[1].tolist())),),
    )
    plan = planned(fresh(now), last, now)
    assert_sound(plan, now)
    assert plan.rung is not Rung.SHIFTED
    assert_same(plan, planned(fresh(now), problem=now))
