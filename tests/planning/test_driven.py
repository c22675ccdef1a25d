"""Plans of robots that cannot turn or stop at will: verified, stoppable, as good as they can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from motion_scene import DOUBLE, WHEELS, at_state, driven_problem, planned, with_dynamics
from terms_scene import ENERGY, LEARNING, TRACKING, terms_problem

from planopt.channel.measurements import Measurements
from planopt.channel.posterior import condition
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.plan import Rung, Verdict, shifted_drive
from planopt.planning.scene import build_ground
from planopt.planning.values.exploration import workspace_region
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.robots.dynamics import rolled_out
from planopt.robots.models import DoubleIntegrator, Unicycle
from planopt.world.workspace import Obstacle, Workspace

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


def test_double_integrator_that_starts_at_speed_matches_the_single_one() -> None:
    """Along a straight way at full speed both do the same, to the pads of planning."""
    problem = terms_problem(TRACKING, horizon=4)
    target = replace(problem.targets[0], start_m=(10.0, 36.0), velocity_m_s=(1.5, 0.0))
    robot = replace(problem.robots[0], start_m=(10.0, 16.0))
    problem = replace(problem, targets=(target,), robots=(robot,))
    single, _, _, _ = planned_single(problem)
    length = single.positions_m[1] - single.positions_m[0]
    velocity = length / np.linalg.norm(length) * (2.0 - 1e-9)
    double, _, _, _ = planned(with_dynamics(problem, DoubleIntegrator(2.0, 50.0), *velocity))
    assert double.objective == pytest.approx(single.objective, rel=2e-3)
    assert double.positions_m == pytest.approx(single.positions_m, abs=0.1)


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
def test_mirrored_scene_gives_the_mirrored_plan(dynamics) -> None:
    """Exchanging x and y exchanges them in the plan."""
    problem = driven_problem(dynamics, TRACKING, horizon=5)
    plan, situation, judge, _ = planned(problem)
    mirrored, other_situation, other_judge = mirror(problem, situation, judge)
    ground = build_ground(mirrored, other_situation.position_m)
    context = replace(other_judge.context, index=ground.index)
    other_judge = replace(other_judge, context=context)
    other = HorizonPlanner(mirrored, ground).plan(other_situation, other_judge)
    assert other.objective == pytest.approx(plan.objective, rel=1e-4)
    assert other.positions_m[:, ::-1] == pytest.approx(plan.positions_m, abs=2e-2)


def mirror(problem, situation, judge):
    """The same with x and y exchanged, measurements included."""
    robot, target, station = problem.robots[0], problem.targets[0], problem.stations[0]
    dynamics = robot.dynamics
    rest = (
        (np.pi / 2.0 - robot.start_rest[0],)
        if isinstance(dynamics, Unicycle)
        else (robot.start_rest[::-1])
    )
    swapped = replace(
        problem,
        workspace=Workspace(
            problem.workspace.bounds_m,
            tuple(
                Obstacle(o.name, shapely.transform(o.polygon, lambda xy: xy[:, ::-1]))
                for o in problem.workspace.obstacles
            ),
        ),
        robots=(replace(robot, start_m=robot.start_m[::-1], start_rest=rest),),
        stations=(replace(station, position_m=station.position_m[::-1]),),
        targets=(
            replace(
                target,
                start_m=target.start_m[::-1],
                velocity_m_s=target.velocity_m_s[::-1],
            ),
        ),
    )
    old = situation.posterior
    taken = old.measurements
    station_site = swapped.stations[0].site
    parameters = replace(old.parameters, station=station_site)
    measured = Measurements(taken.positions_m[:, ::-1].copy(), taken.power_dbm, taken.censored)
    posterior = condition(parameters, measured)
    other = replace(
        situation,
        problem=swapped,
        posteriors=(posterior,),
        state=swapped.robots[0].start_state,
        target_m=situation.target_m[:, ::-1].copy(),
        region=workspace_region(swapped),
    )
    return swapped, other, replace(judge, context=other, objective=ObjectiveValue(other))


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
