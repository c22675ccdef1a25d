"""Falsifications of how the verifier judges states and inputs: each changes a judgement."""

from collections.abc import Callable, Iterator

import casadi as ca
import numpy as np
import pytest
from motion_scene import DOUBLE, WHEELS, driven_problem
from mutants import module_of, mutated, source_of
from terms_scene import LEARNING

from planopt.extend import CasadiMap
from planopt.planning.proof import motion
from planopt.robots.dynamics import Drive, rolled_out
from planopt.world import index_obstacles

MOTION = motion.__name__

MUTANTS = {
    "clearance of all but the last step": (
        "curves(states[:-1], drive.inputs,",
        "curves(states[:-2], drive.inputs[:-1],",
    ),
    "largest clearance": ("np.min(each, initial=np.inf)", "np.max(each, initial=0.0)"),
    "any step clear": ("CLEARANCE_TOLERANCE_M).all()", "CLEARANCE_TOLERANCE_M).any()"),
    "any way within": ("if not all(_within", "if not any(_within"),
    "bounds not looked at": ("if not all(_within(problem, curve) for curve in curves)", "if False"),
    "stopping not looked at": ("if stop is not None", "if False"),
    "stopping out of bounds": ("if not _within(problem, stop)", "if False"),
    "clearance of stopping lost": ("clearance = min(clearance, float(after[0]))", "pass"),
    "start not looked at": ("np.abs(states[0] - start)", "np.abs(states[0] - states[0])"),
    "path not looked at": (
        "np.abs(states[:, :2] - positions_m)",
        "np.abs(states[:, :2] - states[:, :2])",
    ),
    "inputs not looked at": ("np.abs(reached - states[1:])", "np.abs(reached - reached)"),
    "limits not looked at": (
        "over = max(0.0, dynamics.excess_m",
        "over = min(0.0, dynamics.excess_m",
    ),
    "rest not looked at": ("np.max(moving * unit_m", "np.min(0.0 * moving * unit_m"),
    "tolerance times a million": ("if not defect <= DYNAMICS", "if not defect <= 1e6 * DYNAMICS"),
    "shape of inputs": ("or drive.inputs.shape != (len(positions_m) - 1, inputs)", ""),
    "finite check dropped": ("np.isfinite(drive.states).all()", "True"),
}


def cases() -> Iterator[tuple]:
    """Arguments of the scorer: good drives, and each with one thing wrong."""
    for dynamics in (DOUBLE, WHEELS):
        problem = driven_problem(dynamics, LEARNING, horizon=3)
        index = index_obstacles(problem.workspace)
        state = problem.robots[0].start_state
        inputs = np.tile([0.35, 0.3], (3, 1))
        good = rolled_out(dynamics, state, inputs, 1.0)
        path = good.positions_m
        yield problem, index, state, path, good
        other = state.copy()
        other[-1] += 0.01
        yield problem, index, other, path, good
        yield problem, index, state, path + 1e-3, good
        yield problem, index, state, path, Drive(dynamics, good.states, inputs + 1e-3)
        over = rolled_out(dynamics, state, np.tile([0.3, 0.905], (3, 1)), 1.0)
        yield problem, index, state, over.positions_m, over
        short = Drive(dynamics, good.states, inputs[:-1])
        yield problem, index, state, path, short
        states = good.states.copy()
        states[1, -1] = np.nan
        yield problem, index, state, path, Drive(dynamics, states, inputs)
        beside = problem.robots[0].start_state
        beside[:2] = (10.0, 39.9)
        if dynamics is DOUBLE:
            beside[2:] = (0.0, 0.5)
            out = rolled_out(DOUBLE, beside, np.array([[0.0, -0.8], [0.0, -0.1]]), 1.0)
            yield problem, index, beside, out.positions_m, out
            for start, control in (([14.6, 20.0, 1.9, 0.0], 0.0), ([36.5, 36.0, 1.9, 0.0], 0.0)):
                fast = rolled_out(DOUBLE, np.array(start), np.array([[control, 0.0]]), 1.0)
                yield problem, index, np.array(start), fast.positions_m, fast
            stopping = np.array([14.2, 20.0, 1.9, 0.0])
            slow = rolled_out(DOUBLE, stopping, np.array([[-0.8, 0.0]]), 1.0)
            yield problem, index, stopping, slow.positions_m, slow
        else:
            beside[1:] = (39.95, 0.4)
            out = rolled_out(WHEELS, beside, np.array([[1.0, -0.8], [1.0, 0.0]]), 1.0)
            yield problem, index, beside, out.positions_m, out
            near = np.array([15.0, 20.0, 0.0])
            into = rolled_out(WHEELS, near, np.array([[0.0, 0.0], [1.9, 0.0], [1.9, 0.0]]), 1.0)
            yield problem, index, near, into.positions_m, into
    yield resting(0.0)
    yield resting(0.5)


def resting(speed: float) -> tuple:
    """A map that must end at rest, driven at a speed."""
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 3)
    model = CasadiMap(
        ca.Function("next", [x, u], [x + u[:2] + u[2]]),
        ("x_m", "y_m"),
        ("right_m", "up_m", "drift_m"),
        2.0,
        ((0.0, 40.0),) * 2,
        ((-1.0, 1.0),) * 3,
        (0.0, 0.0, speed),
    )
    problem = driven_problem(model, LEARNING, horizon=1)
    state = np.array([10.0, 15.0])
    drive = rolled_out(model, state, np.array([[0.5, 0.0, 0.0]]), 1.0)
    return problem, index_obstacles(problem.workspace), state, drive.positions_m, drive


def said(scorer: Callable) -> list[tuple]:
    """What a scorer says of every case."""
    found: list[tuple] = []
    for arguments in cases():
        try:
            with np.errstate(all="ignore"):
                motion_of = scorer(*arguments)
            found.append((motion_of.reasons, round(motion_of.clearance_m, 6)))
        except Exception as error:
            found.append((type(error).__name__,))
    return found


TRUE = said(motion.verify_motion)


def test_source_as_it_is() -> None:
    """Good drives are sound, and every other has a reason."""
    assert TRUE == said(module_of(MOTION, source_of(MOTION)).verify_motion)
    assert sum(not case[0] for case in TRUE) == 4
    assert all(len(case) == 2 for case in TRUE)


@pytest.mark.parametrize("name", MUTANTS)
def test_mutant_is_found_out(name: str) -> None:
    mutant = module_of(MOTION, mutated(MOTION, *MUTANTS[name]))
    assert said(mutant.verify_motion) != TRUE
