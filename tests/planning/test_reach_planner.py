"""One receding-horizon step on small scenes, and its fallbacks."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from failing_solvers import no_numbers, with_status
from scenes import CUP, RING, WALL, bad_disc, belief_of, good_everywhere, small_problem, verified

import planopt.planning.refinement as refine_module
from planopt import Plan, Problem, Verdict
from planopt.extend import Rung, Termination
from planopt.planning.programme import path_nlp
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene
from planopt.problems.problem import path_cost_s

SLIT = (shapely.box(15, 0, 25, 14.2), shapely.box(15, 15.9, 25, 30))
# Two brackets whose arms reach into each other: the way between them has two turns.
BRACKETS = (
    shapely.Polygon([(12, 0), (22, 0), (22, 14), (20, 14), (20, 2), (14, 2), (14, 14), (12, 14)]),
    shapely.Polygon([(16, 4), (18, 4), (18, 16), (26, 16), (26, 30), (24, 30), (24, 18), (16, 18)]),
)


def planned(problem: Problem, power_at=good_everywhere, position_m=None, warm=None) -> Plan:
    """The plan at the start, or at another place."""
    planner = ReachPlanner(problem, build_scene(problem))
    at = problem.robots[0].start_m if position_m is None else position_m
    return planner.plan(belief_of(problem, power_at), np.asarray(at, dtype=float), warm)


def assert_good(problem: Problem, plan: Plan, power_at=good_everywhere) -> None:
    """Verified again from scratch, no worse than the lattice, all columns of one length."""
    assert plan.verdict is Verdict.VERIFIED
    assert plan.objective <= plan.lattice_objective
    count = problem.planner.horizon + 1
    assert plan.positions_m.shape == (count, 2)
    for column in (plan.t_s, plan.mean_dbm, plan.deviation_db, plan.connectivity):
        assert column.shape == (count,)
        assert np.isfinite(column).all()
    lengths = np.linalg.norm(np.diff(plan.positions_m, axis=0), axis=1)
    assert lengths.max() <= problem.step_length_m + 1e-5
    obstacles = shapely.union_all([o.polygon for o in problem.workspace.obstacles])
    if not obstacles.is_empty:
        way = shapely.LineString(plan.positions_m)
        assert way.distance(obstacles) >= problem.constraints.clearance_m - 1e-6
    found = verified(
        problem,
        build_scene(problem).index,
        belief_of(problem, power_at).posterior,
        plan.positions_m[0],
        plan.positions_m,
        plan.certificate.kkt_residual,
    )
    assert (found.certificate, found.verdict) == (plan.certificate, plan.verdict)


SCENES: dict[str, Problem] = {
    "open": small_problem(),
    "wall": small_problem(WALL),
    "wall, long": small_problem(WALL, horizon=20),
    "out of a cup": small_problem(CUP, start_m=(18.0, 15.0), horizon=20),
    "into a cup": small_problem(CUP, start_m=(35.0, 15.0), goal_m=(18.0, 15.0), horizon=20),
    "in a courtyard": small_problem(RING, start_m=(18.0, 15.0), goal_m=(22.0, 15.0)),
    "round a ring": small_problem(RING, horizon=12),
    "slit": small_problem(*SLIT, horizon=12, start_m=(12.0, 14.0)),
    "brackets": small_problem(*BRACKETS, horizon=25, start_m=(10.0, 15.0), goal_m=(22.0, 20.0)),
    "one step ahead": small_problem(CUP, horizon=1),
    "sixty steps ahead": small_problem(CUP, horizon=60),
    "goal within one step": small_problem(goal_m=(6.5, 15.0)),
    "start at clearance": small_problem(WALL, start_m=(19.4, 15.0), horizon=8),
    "geodesic": small_problem(CUP, cost_to_go="geodesic", horizon=10),
    "no effort": small_problem(WALL, effort_weight_s2_m2=0.0, horizon=10),
    "thrifty": small_problem(WALL, effort_weight_s2_m2=2.0, horizon=10),
    "along the border": small_problem(start_m=(5.0, 0.0), goal_m=(35.0, 0.5), horizon=10),
    "no clearance": small_problem(WALL, clearance_m=0.0, horizon=10, start_m=(15.0, 15.0)),
}


@pytest.mark.parametrize("name", SCENES)
def test_scene(name):
    """A verified plan that is no worse than the lattice's."""
    assert_good(SCENES[name], planned(SCENES[name]))


@pytest.mark.parametrize("planner", ["auto", "lattice"])
def test_straight_way_costs_what_the_formula_says(planner):
    """30 m in the open at 2 m/s: the steps' cost and the rest at the cheapest rate, by hand."""
    problem = small_problem(planner=planner, effort_weight_s2_m2=0.1)
    plan = planned(problem)
    # (1 + w v^2) / v at v = 2 for each of 30 metres.
    assert plan.objective >= 30.0 * (1.0 + 0.1 * 4.0) / 2.0 - 1e-3
    if planner == "auto":
        assert plan.objective == pytest.approx(21.0, abs=1e-3)
    else:
        assert plan.termination is Termination.LATTICE_ONLY
        assert plan.rung is Rung.PLAN
        assert plan.objective == plan.lattice_objective


def test_hole_below_the_bound_is_gone_round():
    """The bound is kept at every step, and no path is straight."""
    problem = small_problem(horizon=16)
    power = bad_disc(20.0, 15.0, 5.0)
    plan = planned(problem, power)
    assert_good(problem, plan, power)
    assert (plan.connectivity[1:] >= 0.9 - 1e-6).all()
    assert plan.certificate.relaxed_steps == ()
    assert np.abs(plan.positions_m[:, 1] - 15.0).max() > 3.0


def test_start_below_the_bound():
    """Connected places are three steps off: a relaxed beginning, verified, with its dB."""
    problem = small_problem(horizon=6)
    power = bad_disc(5.0, 15.0, 5.0)
    plan = planned(problem, power)
    assert_good(problem, plan, power)
    certificate = plan.certificate
    assert plan.rung is Rung.RELAXED
    assert certificate.relaxed_steps[:2] == (1, 2)
    # No way out that the verifier finds is cheaper by more than a step.
    assert certificate.path_cost_m <= 1.05 * certificate.best_cost_m + 2.0
    assert f"{max(certificate.relaxation_db):.2f} dB" in plan.message
    assert "steps 1 to 2" in plan.message
    assert (plan.connectivity[-2:] >= 0.9 - 1e-6).all()


def test_warm_plan_is_no_worse():
    """Following its own plan, the next step costs what was left, or less."""
    problem = SCENES["wall, long"]
    planner = ReachPlanner(problem, build_scene(problem))
    belief = belief_of(problem)
    first = planner.plan(belief, np.asarray(problem.robots[0].start_m))
    second = planner.plan(belief, first.positions_m[1], first)
    assert_good(problem, second)
    spent = path_cost_s(first.positions_m[:2], np.array([35.0, 15.0]), 1.0, 1.0, 0.1)
    assert second.objective <= first.objective - spent + 0.05


def test_boxed_in():
    """No step can be taken from here: it stays, and says so."""
    pen = shapely.Polygon(
        [(4, 14), (6, 14), (6, 16), (4, 16)],
        [[(4.45, 14.45), (5.55, 14.45), (5.55, 15.55), (4.45, 15.55)]],
    )
    # The scene is built for a free start; the robot then stands in the pen.
    problem = small_problem(pen, start_m=(10.0, 15.0))
    plan = planned(problem, position_m=(5.0, 15.0))
    assert plan.rung is Rung.STOP
    assert plan.termination is Termination.NO_PATH
    assert (plan.positions_m == (5.0, 15.0)).all()
    assert "stands still" in plan.message


def in_zigzag(positions_m):
    return positions_m + 15.0 * (-1.0) ** np.arange(len(positions_m))[:, None]


# Name: (solver, how the step's termination is reported).
FAILURES = {
    "no numbers": (no_numbers, Termination.NUMERICAL_FAILURE),
    "wild points": (with_status(Termination.CONVERGED, in_zigzag), Termination.CONVERGED),
    "into the wall": (
        with_status(Termination.CONVERGED, lambda q: q * (1.0, 0.0) + (0.0, 15.0)),
        Termination.CONVERGED,
    ),
    "out of the workspace": (
        with_status(Termination.CONVERGED, lambda q: q + (0.0, 40.0)),
        Termination.CONVERGED,
    ),
    "out of time": (with_status(Termination.TIME_LIMIT, lambda q: q + 3.0), Termination.TIME_LIMIT),
    "infeasible": (with_status(Termination.INFEASIBLE, lambda q: 0.0 * q), Termination.INFEASIBLE),
    "out of iterations": (
        with_status(Termination.ITERATION_LIMIT, in_zigzag),
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


def without_lattice(planner: ReachPlanner, monkeypatch) -> None:
    """No node is in reach any more."""
    monkeypatch.setattr(planner._search, "find_start", lambda *_: None)


def test_shifted_plan(monkeypatch):
    """Without a start path the last verified plan goes on, if it keeps the bound of today."""
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
    planner = planner_of(PROBLEM)
    first = planner.plan(belief_of(PROBLEM), np.array([17.0, 15.0]))
    without_lattice(planner, monkeypatch)
    ahead = first.positions_m[4]
    today = belief_of(PROBLEM, bad_disc(*ahead, 3.0))
    plan = planner.plan(today, first.positions_m[1], first)
    assert plan.rung is Rung.STOP


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
