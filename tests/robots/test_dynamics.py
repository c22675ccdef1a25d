"""The models' steps against an integrator, hulls against dense samples, limits, braking."""

import casadi as ca
import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from planopt.extend import Dynamics
from planopt.problems import DoubleIntegrator, Unicycle
from planopt.robots.dynamics import dynamics_defect_m, rolled_out
from planopt.robots.models import sinc

STEP_S = 0.7
DOUBLE = DoubleIntegrator(3.0, 1.3)
WHEELS = Unicycle(3.0, 2.5, -1.0)


def slope_of(dynamics: Dynamics, state: NDArray[np.float64], control: NDArray[np.float64]):
    if isinstance(dynamics, DoubleIntegrator):
        return np.array([state[2], state[3], control[0], control[1]])
    speed, rate = control
    return np.array([speed * np.cos(state[2]), speed * np.sin(state[2]), rate])


def draws(dynamics: Dynamics, count: int = 12):
    """Random states and inputs within the limits, straight driving and standing among them."""
    generator = np.random.default_rng(7)
    for number in range(count):
        state = generator.uniform(-2.0, 2.0, len(dynamics.state_names))
        control = generator.uniform(-0.9, 0.9, 2)
        if isinstance(dynamics, Unicycle):
            control = control * [1.0, 2.5]
        if number == 0:
            control[1] = 0.0
        if number == 1:
            control[:] = 0.0
        yield state, control


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_step_is_the_integral(dynamics: Dynamics) -> None:
    """A step is what an adaptive integrator of the equations gives."""
    for state, control in draws(dynamics):
        found = solve_ivp(
            lambda _, x, u=control: slope_of(dynamics, x, u),
            (0.0, STEP_S),
            state,
            rtol=1e-11,
            atol=1e-12,
        ).y[:, -1]
        assert dynamics.step(tuple(state), tuple(control), STEP_S) == pytest.approx(found, abs=1e-9)


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_numpy_and_casadi_agree(dynamics: Dynamics) -> None:
    """Step, limits and hulls of both are one to 1e-12."""
    x, u = ca.SX.sym("x", len(dynamics.state_names)), ca.SX.sym("u", 2)
    names = [tuple(ca.vertsplit(x)), tuple(ca.vertsplit(u))]
    after = dynamics.step(*names, STEP_S)
    hull = dynamics.control_points(*names, STEP_S) + dynamics.stop_points(after, STEP_S)
    everything = [*after, *dynamics.limits(names[1], after), *(v for point in hull for v in point)]
    evaluate = ca.Function("all", [x, u], [ca.vertcat(*everything)])
    for state, control in draws(dynamics):
        reached = dynamics.step(tuple(state), tuple(control), STEP_S)
        points = dynamics.control_points(tuple(state), tuple(control), STEP_S)
        points += dynamics.stop_points(reached, STEP_S)
        numbers = [*reached, *dynamics.limits(tuple(control), reached), *np.ravel(points)]
        assert np.array(evaluate(state, control)).ravel() == pytest.approx(numbers, abs=1e-12)


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_hull_contains_the_path(dynamics: Dynamics) -> None:
    """Every place of a step lies in the hull of its ends and its control points."""
    for state, control in draws(dynamics):
        way = np.array(
            [dynamics.step(tuple(state), tuple(control), t)[:2] for t in np.linspace(0, STEP_S, 50)]
        )
        points = [way[0], way[-1], *dynamics.control_points(tuple(state), tuple(control), STEP_S)]
        hull = shapely.MultiPoint(np.array(points)).convex_hull.buffer(1e-9)
        assert hull.covers(shapely.MultiPoint(way))


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_points_of_the_path(dynamics: Dynamics) -> None:
    """Clearance is computed from the path that the steps lead along."""
    for state, control in draws(dynamics):
        (way,) = dynamics.curves(state[None], control[None], STEP_S)
        line, within = way.points_m()
        assert within <= 1e-6
        shape = shapely.LineString(line) if np.ptp(line) else shapely.Point(line[0])
        for t in np.linspace(0.0, STEP_S, 9):
            place = dynamics.step(tuple(state), tuple(control), t)[:2]
            assert shape.distance(shapely.Point(place)) <= within + 1e-12


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS, Unicycle(3.0, 0.2), Unicycle(3.0, 0.4, -2.0)])
def test_what_may_be_reached_has_all_that_is(dynamics: Dynamics) -> None:
    """Random drives within the limits never leave it, and it is no more than the disc of speed."""
    generator = np.random.default_rng(11)
    for _ in range(200):
        state = generator.uniform(-2.0, 2.0, len(dynamics.state_names))
        steps = int(generator.integers(1, 5))
        if isinstance(dynamics, Unicycle):
            low = [dynamics.speed_min_m_s, -dynamics.turn_rate_max_rad_s]
            inputs = generator.uniform(low, [3.0, dynamics.turn_rate_max_rad_s], (steps, 2))
            # The corners of the input set lead farthest.
            inputs[:, 1] = np.sign(inputs[:, 1]) * dynamics.turn_rate_max_rad_s
        else:
            heading = generator.uniform(0.0, 6.3, steps)
            inputs = 1.3 * np.column_stack([np.cos(heading), np.sin(heading)])
        end = rolled_out(dynamics, state, inputs, STEP_S).positions_m[-1:]
        assert dynamics.may_reach(state, end, steps * STEP_S, 1e-9).all()
    beside = np.array([[0.0, 2.9 * STEP_S]])
    ahead = np.zeros(len(dynamics.state_names))
    assert not dynamics.may_reach(ahead, beside, STEP_S, 0.0).any()


def test_double_integrator_brakes_in_time() -> None:
    """It stops at the end of its braking path, within its limits and the hull of its stops."""
    generator = np.random.default_rng(3)
    for _ in range(20):
        heading, speed = generator.uniform(0.0, 6.3), generator.uniform(0.0, 3.0)
        state = np.array([1.0, 2.0, speed * np.cos(heading), speed * np.sin(heading)])
        drive = rolled_out(DOUBLE, state, DOUBLE.braking(state, STEP_S, 6), STEP_S)
        assert np.hypot(*drive.states[-1, 2:]) <= 1e-9
        assert DOUBLE.excess_m(drive.states, drive.inputs, STEP_S) <= 1e-12
        end = DOUBLE.stop_curve(state, STEP_S).places_m[-1]
        assert drive.positions_m[-1] == pytest.approx(end, abs=1e-9)
        (ahead,) = DOUBLE.stop_points(tuple(state), STEP_S)
        hull = shapely.LineString([state[:2], ahead]).buffer(1e-9)
        assert hull.covers(shapely.Point(end))


def test_rest_of_braking_is_braking() -> None:
    """After a step of braking, braking anew is the rest of it: a shifted plan stays one."""
    state = np.array([0.0, 0.0, 2.3, -1.1])
    inputs = DOUBLE.braking(state, STEP_S, 5)
    for step in range(1, 5):
        there = rolled_out(DOUBLE, state, inputs[:step], STEP_S).states[-1]
        again = DOUBLE.braking(there, STEP_S, 5 - step)
        assert again == pytest.approx(inputs[step:], abs=1e-9)


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_following_keeps_limits_and_arrives(dynamics: Dynamics) -> None:
    """Inputs along a bent path keep the limits and lead to half a step from its end."""
    path = np.array([[1.5, 0.0], [3.0, 0.0], [3.0, 1.5], [3.0, 3.0]] + [[3.0, 3.0]] * 8)
    state = np.zeros(len(dynamics.state_names))
    drive = rolled_out(dynamics, state, dynamics.following(state, path, STEP_S), STEP_S)
    assert dynamics.excess_m(drive.states, drive.inputs, STEP_S) <= 1e-9
    assert np.linalg.norm(drive.positions_m[-1] - path[-1]) < 0.5 * 3.0 * STEP_S


@pytest.mark.parametrize(
    ("dynamics", "column", "beyond"), [(DOUBLE, 0, 1.31), (WHEELS, 0, 3.01), (WHEELS, 0, -1.01)]
)
def test_excess_is_seen(dynamics: Dynamics, column: int, beyond: float) -> None:
    """An input a little over its limit counts."""
    inputs = np.zeros((3, 2))
    state = np.zeros(len(dynamics.state_names))
    assert dynamics.excess_m(rolled_out(dynamics, state, inputs, 0.1).states, inputs, 0.1) <= 0.0
    inputs[1, column] = beyond
    drive = rolled_out(dynamics, state, inputs, 0.1)
    assert dynamics.excess_m(drive.states, inputs, 0.1) > 0.0


def test_sinc_is_numpys() -> None:
    """To round-off over a half turn to either side, zero and tiny angles included."""
    angle = np.concatenate([np.linspace(-np.pi, np.pi, 2001), [0.0, 1e-300, 1e-9, -1e-5]])
    assert sinc(angle) == pytest.approx(np.sinc(angle / np.pi), abs=4e-15)


def test_derivative_at_zero() -> None:
    """CasADi's derivative of it is finite at zero, where sin(z)/z has none as it is written."""
    z = ca.SX.sym("z")
    both = ca.Function("both", [z], [ca.jacobian(sinc(z), z), ca.hessian(sinc(z), z)[0]])
    slope, curvature = both(0.0)
    assert float(slope) == 0.0
    assert float(curvature) == pytest.approx(-1.0 / 3.0, abs=1e-14)


PATH = np.array([[1.0, 1.0], [4.0, 1.0], [4.0, 5.0], [4.0, 5.0]])
START = np.array([1.0, 1.0])


def test_a_path_within_the_speed_has_none():
    """Steps of 3, 4 and 0 m are allowed where 4 m are; a shorter limit is missed by the rest."""
    assert dynamics_defect_m(PATH, START, 4.0) == 0.0
    assert dynamics_defect_m(PATH, START, 3.5) == pytest.approx(0.5)
    assert dynamics_defect_m(PATH, START, 2.0) == pytest.approx(2.0)


def test_a_path_that_begins_elsewhere_jumps():
    """The jump to its first place counts even where every step is short enough."""
    assert dynamics_defect_m(PATH, np.array([1.0, 4.0]), 10.0) == pytest.approx(3.0)
    assert dynamics_defect_m(PATH, np.array([1.0, 1.5]), 2.0) == pytest.approx(2.0)


def test_a_path_without_steps_can_only_jump():
    assert dynamics_defect_m(PATH[:1], START, 1.0) == 0.0
    assert dynamics_defect_m(PATH[:1], np.array([1.0, 3.0]), 1.0) == 2.0


def test_not_a_number_is_no_small_defect():
    """NaN in a path is never taken for a path that keeps the model."""
    broken = PATH.copy()
    broken[2] = np.nan
    assert not dynamics_defect_m(broken, START, 4.0) <= 1e-5
