"""Plans for sums of terms: no worse than their guesses, fallbacks, invariances."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import shapely
from failing_solvers import no_numbers, with_status
from terms_scene import (
    CONNECT,
    ENERGY,
    LEARNING,
    TRACKING,
    context_of,
    own_term,
    scorer_of,
    terms_problem,
)

from planopt import InputError, Obstacle, Plan, Verdict
from planopt.channel import condition, measure
from planopt.channel.kriging import bound_margin_db
from planopt.channel.posterior import predict
from planopt.extend import Rung, Termination
from planopt.planning import refinement
from planopt.planning.free_space import free_places
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.initial_data import prepare
from planopt.planning.programme import path_nlp
from planopt.planning.refinement import polish_path
from planopt.planning.search.fan_guesses import fan_paths, rough_clearance
from planopt.planning.search.guess_search import Guess, GuessSearch
from planopt.planning.solve import solve

INFORMATION = {"kind": "mapping", "form": "information"}


def planned(problem, warm=None, seed=0):
    """A plan from the problem's start, and the situation it was made in."""
    context, belief = context_of(problem, seed)
    scorer, ground = scorer_of(context, belief)
    return HorizonPlanner(problem, ground).plan(context, scorer, warm), context, scorer


@pytest.mark.parametrize(
    "terms",
    [
        (TRACKING,),
        (LEARNING,),
        (INFORMATION,),
        (TRACKING, LEARNING, ENERGY),
        (TRACKING, ENERGY),
        ({**TRACKING, "form": "recourse"},),
        ({**TRACKING, "form": "recourse"}, LEARNING, ENERGY),
        (CONNECT,),
        (CONNECT, ENERGY),
    ],
)
@pytest.mark.parametrize("horizon", [1, 8])
def test_plan_is_verified_and_better_than_its_start(terms, horizon):
    plan, _, scorer = planned(terms_problem(*terms, horizon=horizon))
    assert plan.verdict is Verdict.VERIFIED
    assert plan.rung in (Rung.PLAN, Rung.LATTICE)
    assert plan.objective >= plan.lattice_objective - 1e-9
    assert plan.objective == pytest.approx(scorer.objective(plan.positions_m[1:]))
    assert len(plan.positions_m) == horizon + 1


@pytest.mark.parametrize("horizon", [1, 5])
def test_an_expression_of_ones_own_is_planned(horizon):
    """One that is equation 4.11 has the value of the built-in term, from the coupled search.

    The lattice adds that up over stages; both are polished.
    """
    keys = ("sweet_spot_m", "noise_curvature", "noise_floor_m2")
    spot, curvature, floor = (TRACKING[key] for key in keys)

    def seeds(path):
        away = ca.sqrt(ca.sum2((path.positions_m - path.target_m) ** 2) + 1e-6)
        return ca.sum1(path.connectivity / (curvature * (away - spot) ** 2 + floor))

    still = {**TRACKING, "weight": 0.0}
    own, _, scorer = planned(terms_problem(own_term(seeds, horizon), still, horizon=horizon))
    built_in, *_ = planned(terms_problem(TRACKING, horizon=horizon))
    assert own.verdict is Verdict.VERIFIED
    assert own.objective >= own.lattice_objective
    assert own.objective == pytest.approx(scorer.objective(own.positions_m[1:]))
    assert own.objective > 0.98 * built_in.objective


def test_an_expression_of_another_horizon_is_refused():
    """As an error of ours, when the horizon is overridden."""
    problem = terms_problem(own_term(lambda path: -ca.sumsqr(path.positions_m)))
    with pytest.raises(InputError, match=r"is 5, but planner\.horizon is 3"):
        solve(problem, horizon=3)


def test_without_starts_the_last_plan_goes_on(monkeypatch):
    """The shifted plan is checked again; without one the robot stands."""
    problem = terms_problem(TRACKING)
    first, *_ = planned(problem)
    monkeypatch.setattr(GuessSearch, "find_guesses", lambda *_: [])
    context, belief = context_of(problem)
    context = replace(context, state=first.positions_m[1])
    scorer, ground = scorer_of(context, belief)
    planner = HorizonPlanner(problem, ground)
    shifted = planner.plan(context, scorer, first)
    assert (shifted.rung, shifted.verdict) == (Rung.SHIFTED, Verdict.VERIFIED)
    standing = planner.plan(context, scorer)
    assert standing.rung is Rung.STOP
    assert np.ptp(standing.positions_m, axis=0).max() == 0.0


def test_bound_is_kept_where_the_neighbours_mislead(monkeypatch):
    """Strong, far-reaching shadowing and few neighbours: errors of tenths of a dB are mended."""
    problem = terms_problem(TRACKING, p_min=0.8, horizon=8, neighbours=8)
    context, belief = context_of(problem)
    truth = prepare(problem, 0).truths[0]
    measured = measure(truth, free_places(problem, 300, np.random.default_rng(3)))
    parameters = replace(
        context.posterior.parameters, shadow_std_db=9.0, decorrelation_m=70.0, multipath_std_db=4.0
    )
    returned = []

    def remembered(nlp, task):
        point = polish_path(nlp, task)
        returned.append((task, point))
        return point

    monkeypatch.setattr(refinement, "polish_path", remembered)
    errors = []
    for threshold in (-39.5, -38.5, -38.0):
        radio = replace(problem.stations[0], threshold_dbm=threshold)
        strict = replace(problem, stations=(radio,))
        posterior = condition(parameters, measured)
        there = replace(context, problem=strict, posteriors=(posterior,))
        scorer, ground = scorer_of(there, replace(belief, posterior=posterior))
        returned.clear()
        plan = HorizonPlanner(strict, ground).plan(there, scorer)
        assert plan.verdict is Verdict.VERIFIED
        assert not plan.certificate.relaxed_steps
        assert plan.connectivity[1:].min() >= 0.8 - 1e-6
        for task, point in returned:
            power = predict(posterior, point.path_m)
            exact = bound_margin_db(power.mean_db, power.deviation_db, threshold, 0.8)
            errors.append(np.abs(task.evaluate(point.path_m).margins.value - exact).max())
    assert max(errors) > 0.3


PROBLEM = terms_problem(TRACKING, LEARNING, ENERGY, p_min=0.6)


FAILURES = {
    "no numbers": (no_numbers, Termination.NUMERICAL_FAILURE),
    "infeasible": (with_status(Termination.INFEASIBLE, lambda q: 0.0 * q), Termination.INFEASIBLE),
    "out of time": (with_status(Termination.TIME_LIMIT, lambda q: q + 3.0), Termination.TIME_LIMIT),
    "out of iterations": (
        with_status(Termination.ITERATION_LIMIT, lambda q: q[::-1]),
        Termination.ITERATION_LIMIT,
    ),
    "through the obstacle": (
        with_status(Termination.CONVERGED, lambda q: 0.0 * q + (20.0, 20.0)),
        Termination.CONVERGED,
    ),
}


def planned_by(planner: HorizonPlanner, warm: Plan | None = None, problem=PROBLEM) -> Plan:
    """A plan from the start of the problem, of a situation that has seen nothing yet."""
    context, belief = context_of(problem)
    return planner.plan(context, scorer_of(context, belief)[0], warm)


def fresh(problem=PROBLEM) -> HorizonPlanner:
    context, belief = context_of(problem)
    return HorizonPlanner(problem, scorer_of(context, belief)[1])


def assert_same(plan: Plan, other: Plan) -> None:
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
    used, expected = fresh(), planned_by(fresh())
    assert expected.rung is Rung.PLAN
    monkeypatch.setattr(path_nlp, "call_nlp", solver)
    plan = planned_by(used)
    assert_sound(plan)
    assert plan.rung is Rung.LATTICE
    assert plan.termination is termination
    assert plan.objective < expected.objective
    monkeypatch.undo()
    assert_same(planned_by(used), expected)


def test_an_obstacle_on_the_last_plan():
    """The map changes between two steps: the last plan is not driven on, nor started from."""
    last = planned_by(fresh())
    middle = 0.5 * (last.positions_m[2] + last.positions_m[3])
    wall = Obstacle("new", shapely.Point(middle).buffer(0.2))
    now = replace(
        PROBLEM,
        workspace=replace(PROBLEM.workspace, obstacles=(*PROBLEM.workspace.obstacles, wall)),
        robots=(replace(PROBLEM.robots[0], start_m=tuple(last.positions_m[1].tolist())),),
    )
    plan = planned_by(fresh(now), last, now)
    assert_sound(plan, now)
    assert plan.rung is not Rung.SHIFTED
    assert_same(plan, planned_by(fresh(now), problem=now))


@pytest.mark.parametrize(
    "term",
    [LEARNING, {"kind": "mapping", "form": "information"}, {"kind": "mapping", "form": "average"}],
)
def test_plans_are_hardly_worse_than_the_best_of_starts(term):
    """Of 12 ways of a fan, in two seeded scenes; benchmarks/bench_information.py has the study."""
    shares = []
    for seed in range(2):
        context, belief = context_of(terms_problem(term), seed)
        scorer, ground = scorer_of(context, belief)
        planner = HorizonPlanner(context.problem, ground)
        plan = planner.plan(context, scorer)
        assert plan.verdict is Verdict.VERIFIED
        rough = rough_clearance(context.problem, ground.index)
        best = plan.objective
        for path in fan_paths(context, ground.index, rough, 5)[::10]:
            start = Guess(path, scorer.objective(path), 0.0)
            for candidate in planner.cascade.refinement.candidates(
                context, scorer, start, Rung.PLAN
            ):
                if candidate.verdict is Verdict.VERIFIED:
                    best = max(best, candidate.objective)
        shares.append(plan.objective / best)
    assert np.mean(shares) >= 0.995
