"""Dynamics from a CasADi function, and Runge-Kutta: order, bounds, clear errors."""

import casadi as ca
import numpy as np
import pytest

from planopt import InputError
from planopt.extend import CasadiMap
from planopt.problems import Unicycle
from planopt.robots.casadi_map import runge_kutta
from planopt.robots.models import cosine, sine

FREE = (-np.inf, np.inf)


def wheels(**options) -> CasadiMap:
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 2)
    slope = ca.vertcat(u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1])
    keys = {
        "function": ca.Function("slope", [x, u], [slope]),
        "state_names": ("x_m", "y_m", "heading_rad"),
        "input_names": ("speed_m_s", "turn_rate_rad_s"),
        "speed_max_m_s": 2.0,
        "state_bounds": (FREE, FREE, FREE),
        "input_bounds": ((0.0, 2.0), (-1.5, 1.5)),
        "rest_input": (0.0, 0.0),
        "continuous": True,
        "substeps": 8,
    }
    return CasadiMap(**{**keys, **options})


def test_step_is_the_written_out_models() -> None:
    model, exact = wheels(), Unicycle(2.0, 1.5)
    states = np.random.default_rng(1).normal(size=(3, 6))
    inputs = np.vstack([np.linspace(0.0, 2.0, 6), np.linspace(-1.5, 1.5, 6)])
    found = np.array(model.step(tuple(states), tuple(inputs), 0.5))
    assert found == pytest.approx(np.array(exact.step(tuple(states), tuple(inputs), 0.5)), abs=1e-6)


def test_path_is_within_its_bound() -> None:
    """The exact arc is nowhere farther from the samples' lines than is said."""
    model, exact = wheels(substeps=2), Unicycle(2.0, 1.5)
    state, control = np.array([0.0, 0.0, 0.4]), np.array([1.2, 1.5])
    (way,) = model.curves(state[None], control[None], 1.0)
    arc, _ = exact.curves(state[None], control[None], 1.0)[0].points_m()
    places, within = way.points_m()
    away = np.linalg.norm(arc[:, None] - places[None], axis=2).min(axis=1)
    assert away.max() <= within + 0.5 * np.linalg.norm(np.diff(places, axis=0), axis=1).max()
    assert within <= model.hull_pad_m(1.0)


def test_a_discrete_map_is_known_at_its_ends_only() -> None:
    """Between them it may be anywhere that its speed allows."""
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 2)
    model = wheels(
        function=ca.Function("next", [x, u], [x + u]),
        state_names=("x_m", "y_m"),
        state_bounds=(FREE, FREE),
        continuous=False,
        substeps=1,
    )
    assert model.step((1.0, 2.0), (0.5, -0.5), 0.1) == pytest.approx((1.5, 1.5))
    (way,) = model.curves(np.zeros((1, 2)), np.array([[3.0, 0.0]]), 2.5)
    assert way.points_m()[1] == pytest.approx(2.0)  # 5 m of way between places 3 m apart


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"state_names": ("x_m", "y_m")}, "function"),
        ({"state_names": ("y_m", "x_m", "heading_rad")}, "state_names"),
        ({"state_bounds": (FREE, FREE)}, "state_bounds"),
        ({"input_bounds": ((1.0, 0.0), FREE)}, "input_bounds"),
        ({"rest_input": (0.0,)}, "rest_input"),
        ({"speed_max_m_s": 0.0}, "speed_max_m_s"),
        ({"continuous": False}, "substeps"),
    ],
)
def test_what_does_not_fit_is_refused(options, key: str) -> None:
    with pytest.raises(InputError) as error:
        wheels(**options)
    assert error.value.key == key


def test_excess_counts_bounds_and_length() -> None:
    """Inputs over their bounds, and steps that the speed does not allow."""
    model = wheels()
    states = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    inputs = np.array([[2.0, 0.0]])
    assert model.excess_m(states, inputs, 0.5) <= 0.0
    assert model.excess_m(states, inputs + [0.01, 0.0], 0.5) > 0.0
    assert model.excess_m(states * 1.01, inputs, 0.5) > 0.0


def test_nothing_to_drive() -> None:
    """No states and inputs give no paths and no excess."""
    model = wheels()
    states, inputs = np.zeros((0, 3)), np.zeros((0, 2))
    assert model.curves(states, inputs, 0.5) == []
    assert model.excess_m(np.zeros((1, 3)), inputs, 0.5) <= 0.0
    after = model.step(tuple(states.T), tuple(inputs.T), 0.5)
    assert [value.shape for value in after] == [(0,)] * 3


def unicycle_slope(state, control):
    return (control[0] * cosine(state[2]), control[0] * sine(state[2]), control[1])


def test_error_falls_with_the_fourth_power() -> None:
    """Against the exact arc, halving the parts divides the error by about 16."""
    state, control = (0.3, -0.2, 0.7), (2.0, 1.9)
    exact = np.array(Unicycle(3.0, 2.0).step(state, control, 1.0))
    errors = [
        np.linalg.norm(np.array(runge_kutta(unicycle_slope, state, control, 1.0, n)[-1]) - exact)
        for n in (4, 8, 16, 32)
    ]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx([4.0, 4.0, 4.0], abs=0.1)


def test_numpy_and_casadi_agree() -> None:
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 2)
    state, control = tuple(ca.vertsplit(x)), tuple(ca.vertsplit(u))
    symbolic = ca.Function(
        "rk", [x, u], [ca.vertcat(*runge_kutta(unicycle_slope, state, control, 0.5, 3)[-1])]
    )
    states = np.random.default_rng(0).normal(size=(5, 3))
    controls = (np.full(5, 1.5), np.full(5, -0.4))
    batch = runge_kutta(unicycle_slope, tuple(states.T), controls, 0.5, 3)[-1]
    for number, one in enumerate(states):
        expected = np.array(symbolic(one, [1.5, -0.4])).ravel()
        assert [column[number] for column in batch] == pytest.approx(expected, abs=1e-12)
