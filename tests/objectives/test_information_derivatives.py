"""Gradients and Hessians of the information objectives: differences, exact values, invariances."""

import dataclasses

import numpy as np
import pytest
from path_scene import CHANNEL, NOTHING, PATH, START, drawn

from planopt.channel.measurements import join
from planopt.channel.nearest.local_channel import LocalChannel, LocalGrid
from planopt.channel.posterior import condition
from planopt.objectives.mapping import (
    Region,
    Uncertainty,
    average_reduction,
    path_information,
    path_uncertainty,
    path_uncertainty_derivatives,
)
from planopt.objectives.path_loss_learning import (
    Criterion,
    average_reduction_derivatives,
    goal_criterion,
    path_information_derivatives,
    path_loss_derivatives,
    path_loss_value,
)

DATA = drawn(12)
POSTERIOR = condition(CHANNEL, DATA)
GRID = np.random.default_rng(4).uniform(0.0, 60.0, (15, 2))
WEIGHT = np.linspace(0.5, 1.5, 15) / 15.0
GOAL = goal_criterion(POSTERIOR, GRID, WEIGHT)
ONE_GOAL = goal_criterion(POSTERIOR, GRID[:1], np.ones(1))
# A path that stands still, comes back, and crosses a measured place.
AWKWARD = np.vstack([PATH[:2], PATH[1], DATA.positions_m[3], PATH[0]])


def learning(criterion):
    """Value with derivatives, and exactly, of a path-loss criterion."""
    return (
        lambda posterior, channel, path: path_loss_derivatives(channel, path, criterion),
        lambda posterior, path: path_loss_value(posterior, path, criterion),
    )


def information(universal):
    """The same of information."""
    return (
        lambda posterior, channel, path: path_information_derivatives(channel, path, universal),
        lambda posterior, path: path_information(posterior, path, universal),
    )


def average(universal):
    """The same of the spatial average."""
    return (
        lambda posterior, channel, path: average_reduction_derivatives(
            channel, LocalGrid.of(channel, GRID, WEIGHT), path, universal
        ),
        lambda posterior, path: average_reduction(posterior, path, Region(GRID, WEIGHT, universal)),
    )


def path_form(universal, threshold=8.0, decay=0.05):
    """The same of the path form."""
    settings = Uncertainty(threshold, decay, START, universal)
    return (
        lambda posterior, channel, path: path_uncertainty_derivatives(channel, path, settings),
        lambda posterior, path: path_uncertainty(posterior, path, settings),
    )


OBJECTIVES = {
    "T": learning(Criterion("T")),
    "D": learning(Criterion("D")),
    "A": learning(Criterion("A")),
    "V": learning(GOAL),
    "V of one goal": learning(ONE_GOAL),
    "information": information(True),
    "information, theta as if known": information(False),
    "average": average(True),
    "average, theta as if known": average(False),
    "path form": path_form(True),
    "path form, theta as if known": path_form(False),
    "path form, near the threshold": path_form(True, threshold=25.0),
    "path form, no threshold, no decay": path_form(True, threshold=0.0, decay=0.0),
}


def evaluate(name, path, posterior=POSTERIOR, count=12):
    """Value and derivatives from the measurements near `PATH`."""
    return OBJECTIVES[name][0](posterior, LocalChannel.around(posterior, PATH, count), path)


@pytest.mark.parametrize("path", [PATH, PATH[:1], AWKWARD], ids=["path", "one step", "awkward"])
@pytest.mark.parametrize("name", OBJECTIVES)
def test_derivatives_are_those_of_central_differences(name, path):
    """Gradient from values, Hessian from gradients, to 1e-6 of the largest; symmetric."""
    channel = LocalChannel.around(POSTERIOR, PATH, 12)
    function = OBJECTIVES[name][0]
    found, h = function(POSTERIOR, channel, path), 1e-5
    gradient, hessian = np.empty(path.size), np.empty((path.size, path.size))
    for p in range(path.size):
        step = h * np.eye(path.size)[p].reshape(path.shape)
        more, less = (function(POSTERIOR, channel, path + s) for s in (step, -step))
        gradient[p] = (more.value - less.value) / (2 * h)
        hessian[p] = (more.gradient - less.gradient) / (2 * h)
    # Rounding of the values limits what differences of them can show.
    noise = 1e-15 * max(1.0, abs(found.value)) / h
    scale = np.abs(gradient).max()
    np.testing.assert_allclose(found.gradient, gradient, atol=1e-6 * scale + 10.0 * noise)
    # Within the roundings third derivatives are large: 1e-10 / eps^2 of the Hessian.
    np.testing.assert_allclose(found.hessian, hessian, atol=2e-6 * np.abs(hessian).max())
    np.testing.assert_allclose(found.hessian, found.hessian.T, atol=1e-12 * np.abs(hessian).max())


@pytest.mark.parametrize("count", [0, 1, 12])
@pytest.mark.parametrize("name", OBJECTIVES)
def test_with_tiny_roundings_the_value_is_exact(name, count, monkeypatch):
    """All measurements used and roundings a billionth: the objective itself, to 1e-7."""
    monkeypatch.setattr("planopt.objectives.rounded_kernel.CUSP_ROUNDING", 1e-9)
    monkeypatch.setattr("planopt.objectives.rounded_kernel.MIN_DISTANCE_M", 0.0)
    monkeypatch.setattr("planopt.objectives.mapping.CUSP_ROUNDING", 1e-9)
    monkeypatch.setattr("planopt.objectives.mapping.THRESHOLD_ROUNDING", 1e-9)
    posterior = condition(CHANNEL, drawn(count) if count else NOTHING)
    exact = OBJECTIVES[name][1](posterior, PATH)
    assert evaluate(name, PATH, posterior).value == pytest.approx(exact, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("name", OBJECTIVES)
def test_the_roundings_cost_little(name):
    """On a path of steps of some metres: within 1 % of the exact value, or of its gain."""
    exact = OBJECTIVES[name][1](POSTERIOR, PATH)
    found = evaluate(name, PATH).value
    scale = abs(exact)
    if name in ("D", "A", "V", "V of one goal"):
        # Most of these is known before; what counts is what the path adds.
        far = np.array([[1e5, 1e5]])
        scale = abs(exact - OBJECTIVES[name][1](POSTERIOR, far))
        assert scale > 0.0
    # The threshold's rounding adds at most 3/16 of its width, 0.01 * 29 dB^2, a step.
    stated = 5.0 * 3.0 / 16.0 * 0.29 if name.startswith("path form") else 0.0
    assert abs(found - exact) < 0.012 * scale + stated


@pytest.mark.parametrize("name", OBJECTIVES)
def test_measurements_far_away_change_nothing(name):
    """The same from the near ones alone, theta's covariance being that of all."""
    near = drawn(12)
    far = drawn(60, seed=8)
    far = dataclasses.replace(far, positions_m=far.positions_m + 500.0)
    both = join(near, far)
    posterior = condition(CHANNEL, both)
    few = evaluate(name, PATH, posterior, 12)
    many = evaluate(name, PATH, posterior, 72)
    assert few.value == pytest.approx(many.value, rel=1e-6)
    np.testing.assert_allclose(few.gradient, many.gradient, atol=1e-6 * np.abs(many.gradient).max())
    np.testing.assert_allclose(few.hessian, many.hessian, atol=1e-6 * np.abs(many.hessian).max())


@pytest.mark.parametrize("name", ["T", "D", "A", "V", "information", "average"])
def test_the_order_of_the_path_permutes_the_derivatives(name):
    """Sets of places: value unchanged, derivatives in the new order."""
    order = np.array([3, 0, 4, 1, 2])
    columns = (2 * order[:, None] + [0, 1]).ravel()
    here, there = evaluate(name, PATH), evaluate(name, PATH[order])
    assert there.value == pytest.approx(here.value, rel=1e-9)
    scale = np.abs(here.hessian).max()
    np.testing.assert_allclose(
        there.gradient, here.gradient[columns], atol=1e-8 * np.abs(here.gradient).max()
    )
    np.testing.assert_allclose(
        there.hessian, here.hessian[np.ix_(columns, columns)], atol=1e-8 * scale
    )


@pytest.mark.parametrize("name", OBJECTIVES)
def test_the_second_order_model_is_one(name):
    """Second-order Taylor series: the error of the value falls with the cube of the step."""
    here = evaluate(name, PATH)
    direction = np.random.default_rng(2).standard_normal(10)
    errors = []
    for size in (4e-2, 2e-2):
        step = size * direction
        model = here.value + here.gradient @ step + 0.5 * step @ here.hessian @ step
        errors.append(abs(evaluate(name, PATH + step.reshape(5, 2)).value - model))
    assert errors[1] < 0.2 * errors[0] + 1e-11
