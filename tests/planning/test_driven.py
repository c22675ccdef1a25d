"""Plans of robots with dynamics for sums of terms: verified, stoppable, settled."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from motion_scene import DOUBLE, WHEELS, at_state, driven_problem, planned, with_dynamics
from terms_scene import ENERGY, LEARNING, TRACKING, terms_problem

from planopt import InputError, Verdict, load, solve
from planopt.extend import CasadiMap, Rung
from planopt.planning.plan import shifted_drive
from planopt.planning.search.guess_search import Guess
from planopt.problems import DoubleIntegrator, Unicycle, problem_from_dict, problem_to_dict
from planopt.robots.dynamics import rolled_out

INFORMATION = {"kind": "mapping", "form": "information"}


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("terms", [(TRACKING,), (LEARNING,), (INFORMATION, ENERGY)])
@pytest.mark.parametrize("horizon", [1, 8])
def test_plan_is_verified_and_driven(dynamics, terms, horizon: int) -> None:
    """Whatever the objective and the horizon; inputs lead along the places."""
    problem = driven_problem(dynamics, *terms, horizon=horizon)
    plan, _, scorer, _ = planned(problem)
    assert plan.verdict is Verdict.VERIFIED
    assert plan.drive is not None
    again = rolled_out(dynamics, scorer.state, plan.drive.inputs, problem.planner.step_s)
    assert again.positions_m == pytest.approx(plan.positions_m, abs=1e-12)
    assert plan.objective == pytest.approx(scorer.objective(plan.positions_m[1:]))


def test_large_acceleration_is_the_single_integrator() -> None:
    """With acceleration and turning without end, places lie as for a robot that turns at will.

    Velocity is continuous from step to step, so that a double integrator never does better; how
    much worse falls with the acceleration, to a thousandth, what searches lose.
    """
    problem = terms_problem(TRACKING, horizon=6)
    single, _, _, _ = planned(problem)
    worth = []
    for largest in (1.0, 10.0, 1000.0):
        fast = with_dynamics(problem, DoubleIntegrator(2.0, largest))
        worth.append(planned(fast)[0].objective)
    assert worth[0] < worth[1]
    assert worth[2] >= worth[1] * (1.0 - 1e-3)
    assert max(worth) <= single.objective * (1.0 + 1e-3)
    wheels, _, _, _ = planned(with_dynamics(problem, Unicycle(2.0, 3.0)))
    assert wheels.objective <= single.objective * (1.0 + 1e-3)


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_last_plan_one_step_later_is_still_sound(dynamics) -> None:
    """Its rest and a step of stopping keep everything, however often it is shifted."""
    problem = driven_problem(dynamics, TRACKING, horizon=5)
    plan, _, scorer, _ = planned(problem)
    for _ in range(7):
        drive = shifted_drive(problem, plan)
        scorer = at_state(scorer, plan.drive.states[1])
        candidate = scorer.candidate(drive.positions_m[1:], Rung.SHIFTED, plan.termination, drive)
        candidate = scorer.assessed(candidate)
        assert candidate.sound
        plan = scorer.plan_from(candidate, 0.0)
    if dynamics is DOUBLE:
        assert np.hypot(*plan.drive.states[-1, 2:]) <= 1e-9


def test_fallbacks_brake_where_that_is_clear_and_else_drives_the_rest(monkeypatch) -> None:
    """Without any start, a moving robot does not jump to rest."""
    problem = driven_problem(DOUBLE, TRACKING, horizon=5)
    plan, context, scorer, planner = planned(problem)
    monkeypatch.setattr(planner._search, "find_guesses", lambda *_: [])
    monkeypatch.setattr("planopt.planning.horizon_planner.driven_starts", lambda *_: [])
    moving = at_state(scorer, plan.drive.states[1])
    unverified = replace(plan, verdict=Verdict.VIOLATED)
    stop = planner.plan(replace(context, state=moving.position_m), moving, unverified)
    assert stop.rung is Rung.STOP
    assert stop.certificate.dynamics_defect <= 1e-9
    assert np.hypot(*stop.drive.states[-1, 2:]) <= 1e-9
    # In front of the block, where braking is not clear: the rest of the last plan is.
    state = np.array([15.0, 20.0, 1.9, 0.0])
    inputs = np.array([[-0.5, 0.6], [-0.5, 0.6], [-0.3, -0.5], [0.0, -0.2], [0.0, 0.0]])
    swerving = rolled_out(DOUBLE, state, inputs, 1.0)
    known = replace(unverified, drive=swerving, positions_m=swerving.positions_m)
    near = at_state(scorer, swerving.states[1])
    again = planner.plan(replace(context, state=near.position_m), near, known)
    assert again.rung is Rung.STOP
    shifted = shifted_drive(problem, known)
    braked = DOUBLE.braking(near.state, 1.0, 5)
    assert (
        np.abs(again.drive.inputs - braked).max() < 1e-12
        or np.abs(again.drive.inputs - shifted.inputs).max() < 1e-12
    )
    assert again.certificate.dynamics_defect <= 1e-9


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize(
    ("terms", "horizon"), [((TRACKING,), 5), ((TRACKING,), 15), ((INFORMATION,), 5)]
)
def test_convex_steps_find_what_interior_points_find(dynamics, terms, horizon) -> None:
    """Though acceleration, speed and heading bound the plan by curved rows."""
    plans = []
    for name in ("nlp", "scp"):
        problem = driven_problem(dynamics, *terms, horizon=horizon, name=name)
        plans.append(planned(problem)[0])
    assert all(plan.verdict is Verdict.VERIFIED for plan in plans)
    assert plans[1].objective == pytest.approx(plans[0].objective, rel=0.01)


HORIZON = 20


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("target_m", [(30.0, 45.0), (10.0, 36.0)])
def test_plan_is_worth_as_much_as_from_random_starts(dynamics, target_m) -> None:
    """Far ahead, and where the best drive is far from the one that the search begins with."""
    problem = driven_problem(dynamics, TRACKING, horizon=HORIZON)
    problem = replace(problem, targets=(replace(problem.targets[0], start_m=target_m),))
    plan, context, scorer, planner = planned(problem)
    assert plan.verdict is Verdict.VERIFIED
    generator = np.random.default_rng(0)
    for _ in range(3):
        drift = 0.5 * generator.normal(size=2)
        turns = 0.1 * np.cumsum(generator.normal(size=(HORIZON, 2)), axis=0)
        way = scorer.position_m + np.cumsum(drift + turns, axis=0)
        start = begun(dynamics, scorer, dynamics.following(scorer.state, way, 1.0))
        for _ in range(3):
            found = planner.cascade.refinement.candidates(context, scorer, start, Rung.PLAN)
            verified = [c for c in found if c.verdict is Verdict.VERIFIED]
            if not verified:
                break
            best = max(verified, key=lambda candidate: candidate.objective)
            assert plan.objective >= 0.98 * best.objective
            start = begun(dynamics, scorer, best.drive.inputs)


def begun(dynamics, scorer, inputs) -> Guess:
    drive = rolled_out(dynamics, scorer.state, inputs, 1.0)
    path = drive.positions_m[1:]
    return Guess(path, scorer.objective(path), 0.0, drive, clear=False)


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_plan_is_settled(dynamics) -> None:
    """Polished again from itself, about its own sides of obstacles, it gains little."""
    plan, context, scorer, planner = planned(driven_problem(dynamics, TRACKING, horizon=HORIZON))
    again = begun(dynamics, scorer, plan.drive.inputs)
    for candidate in planner.cascade.refinement.candidates(context, scorer, again, Rung.PLAN):
        if candidate.verdict is Verdict.VERIFIED:
            assert candidate.objective <= 1.01 * plan.objective


def test_a_curve_too_near_beside_its_chord_is_mended() -> None:
    """The boat's first polish comes 3 cm too near in stopping, where no chord does."""
    tables = problem_to_dict(load("harbour_track"))
    tables["objective"]["terms"][0]["form"] = "additive"
    boat = solve(problem_from_dict(tables), horizon=HORIZON, seed=6).plans[0]
    assert boat.verdict is Verdict.VERIFIED
    assert boat.rung is Rung.PLAN
    assert boat.polish_gain > 1.0


FREE = (-np.inf, np.inf)


def wheels() -> CasadiMap:
    """The unicycle of the scene by its derivative."""
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 2)
    slope = ca.vertcat(u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1])
    return CasadiMap(
        ca.Function("slope", [x, u], [slope]),
        WHEELS.state_names,
        WHEELS.input_names,
        2.0,
        (FREE, FREE, FREE),
        ((0.0, 2.0), (-0.9, 0.9)),
        (0.0, 0.0),
        continuous=True,
        substeps=8,
    )


def heavy() -> CasadiMap:
    """A double integrator in a square of velocities and accelerations, as a discrete map."""
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    after = ca.vertcat(x[:2] + x[2:] + 0.5 * u, x[2:] + u)
    most, hard = 2.0 / np.sqrt(2.0), 0.8 / np.sqrt(2.0)
    return CasadiMap(
        ca.Function("after", [x, u], [after]),
        DOUBLE.state_names,
        DOUBLE.input_names,
        2.0,
        (FREE, FREE, (-most, most), (-most, most)),
        ((-hard, hard), (-hard, hard)),
        (0.0, 0.0),
    )


@pytest.mark.parametrize(("own", "exact"), [(wheels(), WHEELS), (heavy(), DOUBLE)])
def test_plan_is_verified_and_no_better_than_the_exact_models(own, exact) -> None:
    """The map knows less of its way, and must end at rest, so that it cannot do better."""
    problem = terms_problem(TRACKING, horizon=5)
    plan, _, _, _ = planned(with_dynamics(problem, own))
    assert plan.verdict is Verdict.VERIFIED
    end = plan.drive.states[-1]
    assert np.array(own.step(tuple(end), (0.0, 0.0), 1.0)) == pytest.approx(end, abs=1e-5)
    reference, _, _, _ = planned(with_dynamics(problem, exact))
    assert plan.objective <= reference.objective * (1.0 + 1e-3)
    assert plan.objective >= 0.5 * reference.objective


def test_a_function_is_not_for_files() -> None:
    with pytest.raises(InputError, match="cannot be saved"):
        problem_to_dict(with_dynamics(terms_problem(TRACKING), wheels()))
