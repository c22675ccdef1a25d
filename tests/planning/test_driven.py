"""Plans of robots that cannot turn or stop at will: verified, stoppable, as good as they can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motion_scene import DOUBLE, WHEELS, at_state, driven_problem, planned, with_dynamics
from terms_scene import ENERGY, LEARNING, TRACKING, terms_problem

from planopt.planning.plan import Rung, Verdict, shifted_drive
from planopt.robots.dynamics import rolled_out
from planopt.robots.models import DoubleIntegrator, Unicycle

INFORMATION = {"kind": "mapping", "form": "information"}


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("terms", [(TRACKING,), (LEARNING,), (INFORMATION, ENERGY)])
@pytest.mark.parametrize("horizon", [1, 2, 8])
def test_plan_is_verified_and_driven(dynamics, terms, horizon: int) -> None:
    """Whatever the objective and the horizon; inputs lead along the places."""
    problem = driven_problem(dynamics, *terms, horizon=horizon)
    plan, _, judge, _ = planned(problem)
    assert plan.verdict is Verdict.VERIFIED
    assert plan.drive is not None
    again = rolled_out(dynamics, judge.state, plan.drive.inputs, problem.planner.step_s)
    assert again.positions_m == pytest.approx(plan.positions_m, abs=1e-12)
    assert plan.objective == pytest.approx(judge.objective(plan.positions_m[1:]))


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_polish_is_a_kkt_point(dynamics) -> None:
    """The residual, computed without the solver's derivatives, is small."""
    plan, _, _, _ = planned(driven_problem(dynamics, TRACKING, horizon=6))
    assert plan.rung is Rung.PLAN
    assert plan.certificate.kkt_residual < 2e-4


def test_large_acceleration_is_the_single_integrator() -> None:
    """With acceleration and turning without end, places lie as for a robot that turns at will.

    Velocity is continuous from step to step, so that a double integrator never does better; how
    much worse falls with the acceleration, to a thousandth, what searches lose.
    """
    problem = terms_problem(TRACKING, horizon=6)
    single, _, _, _ = planned_single(problem)
    worth = []
    for largest in (1.0, 10.0, 1000.0):
        fast = with_dynamics(problem, DoubleIntegrator(2.0, largest))
        worth.append(planned(fast)[0].objective)
    assert worth[0] < worth[1]
    assert worth[2] >= worth[1] * (1.0 - 1e-3)
    assert max(worth) <= single.objective * (1.0 + 1e-3)
    wheels, _, _, _ = planned(with_dynamics(problem, Unicycle(2.0, 3.0)))
    assert wheels.objective <= single.objective * (1.0 + 1e-3)


def planned_single(problem):
    """The plan of the single integrator."""
    assert problem.robots[0].moves_freely
    return planned(problem)


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_last_plan_one_step_later_is_still_sound(dynamics) -> None:
    """Its rest and a step of stopping keep everything, however often it is shifted."""
    problem = driven_problem(dynamics, TRACKING, horizon=5)
    plan, _, judge, _ = planned(problem)
    for _ in range(7):
        drive = shifted_drive(problem, plan)
        judge = at_state(judge, plan.drive.states[1])
        candidate = judge.candidate(drive.positions_m[1:], Rung.SHIFTED, plan.termination, drive)
        candidate = judge.judged(candidate)
        assert candidate.sound
        plan = judge.plan_from(candidate, 0.0)
    if dynamics is DOUBLE:
        assert np.hypot(*plan.drive.states[-1, 2:]) <= 1e-9


def test_fallbacks_brake_where_that_is_clear_and_else_drives_the_rest(monkeypatch) -> None:
    """Without any start, a moving robot does not jump to rest."""
    problem = driven_problem(DOUBLE, TRACKING, horizon=5)
    plan, situation, judge, planner = planned(problem)
    monkeypatch.setattr(planner._search, "find_guesses", lambda *_: [])
    monkeypatch.setattr("planopt.planning.horizon_planner.driven_starts", lambda *_: [])
    moving = at_state(judge, plan.drive.states[1])
    unverified = replace(plan, verdict=Verdict.VIOLATED)
    stop = planner.plan(replace(situation, state=moving.position_m), moving, unverified)
    assert stop.rung is Rung.STOP
    assert stop.certificate.dynamics_defect <= 1e-9
    assert np.hypot(*stop.drive.states[-1, 2:]) <= 1e-9
    # In front of the block, where braking is not clear: the rest of the last plan is.
    state = np.array([15.0, 20.0, 1.9, 0.0])
    inputs = np.array([[-0.5, 0.6], [-0.5, 0.6], [-0.3, -0.5], [0.0, -0.2], [0.0, 0.0]])
    swerving = rolled_out(DOUBLE, state, inputs, 1.0)
    known = replace(unverified, drive=swerving, positions_m=swerving.positions_m)
    near = at_state(judge, swerving.states[1])
    again = planner.plan(replace(situation, state=near.position_m), near, known)
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
