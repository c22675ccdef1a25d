"""The verdict on motions: edited drives, and distances from moving discs."""

from dataclasses import replace

import numpy as np
import pytest
from motion_scene import DOUBLE, WHEELS, driven_problem
from terms_scene import LEARNING

from planopt.planning.proof.motion import verify_apart, verify_motion
from planopt.robots.dynamics import Drive, rolled_out
from planopt.world import MovingDiscs, TimedMotion, index_obstacles

STEPS = 4


def scene(dynamics):
    """A problem, its obstacles, a start, and a gentle drive from there that is clear."""
    problem = driven_problem(dynamics, LEARNING, horizon=STEPS)
    state = problem.robots[0].start_state
    inputs = np.tile([0.35, 0.3], (STEPS, 1))
    drive = rolled_out(dynamics, state, inputs, problem.planner.step_s)
    return problem, index_obstacles(problem.workspace), state, drive


def assessed(problem, index, state, drive):
    return verify_motion(problem, index, state, drive.positions_m, drive)


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("row", range(STEPS))
@pytest.mark.parametrize("column", [0, 1])
def test_an_edited_input_is_rejected(dynamics, row: int, column: int) -> None:
    """By a thousandth of it: it leads elsewhere."""
    problem, index, state, drive = scene(dynamics)
    inputs = drive.inputs.copy()
    inputs[row, column] += 1e-3
    found = assessed(problem, index, state, replace(drive, inputs=inputs))
    assert any("do not lead from state to state" in reason for reason in found.reasons)
    assert found.defect_m > 1e-5


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("row", range(STEPS + 1))
def test_an_edited_state_is_rejected(dynamics, row: int) -> None:
    """Every component of every state, headings and velocities included."""
    problem, index, state, drive = scene(dynamics)
    for column in range(drive.states.shape[1]):
        states = drive.states.copy()
        states[row, column] += 1e-3
        edited = Drive(dynamics, states, drive.inputs)
        assert assessed(problem, index, state, edited).reasons
        # The path says something else than the states.
        assert verify_motion(problem, index, state, drive.positions_m, edited).reasons


@pytest.mark.parametrize(
    ("dynamics", "inputs"),
    [
        (DOUBLE, [0.81, 0.0]),  # acceleration
        (DOUBLE, [0.6, 0.6]),  # both of it
        (WHEELS, [2.01, 0.0]),
        (WHEELS, [-0.01, 0.0]),
        (WHEELS, [0.5, 0.91]),
        (WHEELS, [0.5, -0.91]),
    ],
)
def test_what_is_over_its_limit_is_rejected(dynamics, inputs) -> None:
    problem, index, state, _ = scene(dynamics)
    drive = rolled_out(dynamics, state, np.tile(inputs, (1, 1)), problem.planner.step_s)
    found = assessed(problem, index, state, drive)
    assert any("over its limit" in reason for reason in found.reasons)


def test_an_arc_into_a_corner_is_rejected_though_its_chord_is_clear() -> None:
    problem, index, _, _ = scene(WHEELS)
    state = np.array([16.6, 13.0, -0.45])
    drive = rolled_out(WHEELS, state, np.array([[2.0, 0.9]] * 2), problem.planner.step_s)
    arc = assessed(problem, index, state, drive).clearance_m
    middle = np.array(WHEELS.step(tuple(state), (2.0, 0.9), 0.5)[:2])
    assert arc < np.abs(18.0 - drive.positions_m[:, 0]).min()
    assert arc <= 18.0 - middle[0]


DISC_STEPS = 4


def discs_of(centres_m, radius_m, least_m, is_robot):
    count = len(centres_m)
    return MovingDiscs(
        tuple("abcdef"[:count]),
        np.asarray(centres_m, dtype=float),
        np.tile(np.asarray(radius_m, dtype=float)[:, None], (1, DISC_STEPS)),
        np.asarray(least_m, dtype=float),
        np.asarray(is_robot),
    )


@pytest.mark.parametrize("seed", range(6))
def test_least_distances_are_those_of_dense_samples(seed):
    """Of robots and of obstacles apart; the reasons name those that come too near."""
    generator = np.random.default_rng(seed)
    centres = np.cumsum(generator.normal(scale=2.0, size=(4, DISC_STEPS + 1, 2)), axis=1)
    path = np.cumsum(generator.normal(scale=2.0, size=(DISC_STEPS + 1, 2)), axis=0)
    radius, least = np.array([0.0, 0.0, 0.4, 0.9]), np.array([1.5, 1.5, 0.5, 0.5])
    discs = discs_of(centres, radius, least, [True, True, False, False])
    found = verify_apart(discs, TimedMotion(path))
    times = np.linspace(0.0, DISC_STEPS, 8001)
    own = np.stack([np.interp(times, range(DISC_STEPS + 1), path[:, a]) for a in (0, 1)])
    away = []
    for centre, size in zip(centres, radius, strict=True):
        other = np.stack([np.interp(times, range(DISC_STEPS + 1), centre[:, a]) for a in (0, 1)])
        away.append(np.hypot(*(own - other)) - size)
    lowest = np.array([values.min() for values in away])
    assert found.min_separation_m == pytest.approx(lowest[:2].min(), abs=2e-3)
    assert found.min_moving_clearance_m == pytest.approx(lowest[2:].min(), abs=2e-3)
    near = [name for name, low, asked in zip("abcd", lowest, least, strict=True) if low < asked]
    assert len(found.reasons) == len(near)
    for name, reason in zip(near, found.reasons, strict=True):
        number = "abcd".index(name)
        kind, key = (
            ("robot", "separation_m is 1.5")
            if number < 2
            else ("moving obstacle", "clearance_m is 0.5")
        )
        step = int(times[away[number].argmin()]) + 1
        assert f"of the {kind} {name}, constraints.{key}" in reason
        assert f"in step {step} " in reason or times[away[number].argmin()] % 1.0 in (0.0, 1.0)
