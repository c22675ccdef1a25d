"""Polished paths against closed forms, one constraint at a time, and after failures."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from reach_tasks import (
    bowl_margins,
    changed,
    constant_margins,
    goal_nlp,
    no_lines,
    outage_of,
    reach_task,
    scored,
    slope_margins,
    with_line,
)
from scipy.optimize import minimize
from scipy.stats import norm

from planopt import Obstacle, Workspace
from planopt.extend import Termination
from planopt.planning.programme import path_nlp
from planopt.planning.programme.goal_value import PIVOT_ROUNDING_M, STEP_ROUNDING_M
from planopt.planning.refinement import polish_path
from planopt.planning.tolerances import CLEARANCE_PAD_M, STEP_PAD_M
from planopt.world import index_obstacles, pack_pieces, separating_lines, swept_clearance_m

N, LINES = 3, 2
ALONG = np.outer(np.arange(1, N + 1), [1.0, 0.0])


@pytest.fixture(scope="module")
def nlp():
    """Three steps, two lines a segment, shared by all tests: reuse must not matter."""
    return goal_nlp(N, LINES)


def solved(nlp, task, tolerance=1e-4):
    """The polished task, converged and with a small residual."""
    polished = polish_path(nlp, task)
    assert polished.termination is Termination.CONVERGED
    assert polished.kkt_residual < tolerance
    return polished


def same(one, two):
    """Whether two results are the same to the last bit."""
    return (
        one.path_m.tobytes() == two.path_m.tobytes()
        and one.slack_db.tobytes() == two.slack_db.tobytes()
        and one.kkt_residual == two.kkt_residual
        and one.iterations == two.iterations
        and one.termination is two.termination
        and all(one.multipliers[k].tobytes() == v.tobytes() for k, v in two.multipliers.items())
    )


# Speed and effort.


@settings(max_examples=20, deadline=None)
@given(st.floats(0.3, 2.0), st.floats(0.3, 3.0), st.floats(0.0, 6.28))
def test_cruising_in_a_straight_line(nlp, effort, rate, heading):
    """Below the speed limit each step is rate / (2 effort) long, in the pivot's direction."""
    length = rate / (2.0 * effort)
    direction = np.array([np.cos(heading), np.sin(heading)])
    task = reach_task(
        N,
        LINES,
        step_length_m=length + 1.0,
        effort_s_m2=effort,
        rate_s_m=rate,
        pivot_m=80.0 * direction,
    )
    polished = solved(nlp, task)
    expected = np.outer(np.arange(1, N + 1) * length, direction)
    np.testing.assert_allclose(polished.path_m, expected, atol=1e-3)
    assert all(np.abs(m).max() < 1e-4 for m in polished.multipliers.values())


def test_limits_of_speed_and_space(nlp):
    """At the speed limit its multiplier is rate / (2 L) - effort; the bounds stop the path."""
    polished = solved(nlp, reach_task(N, LINES))
    np.testing.assert_allclose(polished.path_m, 2.0 * ALONG, atol=1e-4)
    np.testing.assert_allclose(polished.multipliers["speed"], 1.0 / 4.0 - 0.1, atol=1e-5)
    path = np.vstack([np.zeros(2), polished.path_m])
    longest = np.linalg.norm(np.diff(path, axis=0), axis=1).max()
    assert longest <= 2.0 - 0.5 * STEP_PAD_M
    polished = solved(nlp, reach_task(N, LINES, bounds_m=(-9.0, -9.0, 3.0, 9.0)))
    assert polished.path_m[:, 0].max() <= 3.0 + 1e-6
    np.testing.assert_allclose(polished.path_m[-1], [3.0, 0.0], atol=1e-3)


def test_held_positions(nlp):
    """Held positions stay; if all are held there is nothing to choose."""
    path = np.array([[0.5, 1.0], [2.0, 0.0], [2.0, 0.0]])
    polished = solved(nlp, reach_task(N, LINES, path_m=path, held=np.array([False, True, True])))
    np.testing.assert_array_equal(polished.path_m[1:], path[1:])
    np.testing.assert_allclose(polished.path_m[0], [1.0, 0.0], atol=1e-4)
    path = np.tile([1.0, 1.0], (N, 1))
    task = reach_task(N, LINES, path_m=path, held=np.ones(N, dtype=np.bool_))
    polished = solved(nlp, task)
    np.testing.assert_array_equal(polished.path_m, path)
    broken = polish_path(nlp, changed(task, bound=np.full(N, 11.0)))
    assert broken.termination is Termination.INFEASIBLE
    assert broken.kkt_residual == pytest.approx(1.0)


# Lines.


def test_a_line_at_a_segments_end(nlp):
    """A half-plane on the first segment binds its end: y_1 = b with multiplier -2 effort b."""
    b = 0.5
    task = reach_task(
        N,
        LINES,
        effort_s_m2=0.5,
        pivot_m=np.array([50.0, b]),
        path_m=ALONG + np.array([0.0, b]),
        lines=with_line(no_lines(N, LINES), 0, [0.0, 1.0], b - CLEARANCE_PAD_M),
    )
    polished = solved(nlp, task)
    np.testing.assert_allclose(polished.path_m, ALONG + np.array([0.0, b]), atol=2e-3)
    # The start's own end is not constrained: it is where the robot is.
    assert polished.multipliers["line_start"].shape == (N - 1, LINES)
    assert polished.multipliers["line_end"][0, 0] == pytest.approx(-2.0 * 0.5 * b, abs=1e-3)
    assert np.abs(polished.multipliers["line_end"].ravel()[1:]).max() < 1e-4


@pytest.mark.parametrize("clearance", [0.0, 0.3])
def test_a_line_at_a_segments_start(nlp, clearance):
    """A slanted line on the second segment binds q_1 only: q_1 = l e_x + (b - n_x l) n."""
    effort, length, normal, offset = 0.5, 1.0, np.array([0.6, 0.8]), 1.2
    task = reach_task(
        N,
        LINES,
        clearance_m=clearance,
        effort_s_m2=effort,
        pivot_m=np.array([1e5, 0.0]),
        path_m=ALONG + np.array([0.0, 3.0]),
        lines=with_line(no_lines(N, LINES), 1, normal, offset),
        step_length_m=5.0,
    )
    polished = solved(nlp, task)
    b = offset + clearance + CLEARANCE_PAD_M
    first = np.array([length, 0.0]) + (b - normal[0] * length) * normal
    np.testing.assert_allclose(polished.path_m[0], first, atol=1e-3)
    np.testing.assert_allclose(polished.path_m[1:], first + ALONG[:-1], atol=1e-3)
    # Stationarity in q_1: 2 effort q_1 - (rate, 0) + lambda n = 0 with rate = 2 effort l.
    multiplier = -2.0 * effort * (b - normal[0] * length)
    assert polished.multipliers["line_start"][0, 0] == pytest.approx(multiplier, abs=1e-3)
    assert np.abs(polished.multipliers["line_end"]).max() < 1e-4


def test_round_an_obstacle(nlp):
    """Over a box the swept path keeps the clearance, and touches a line."""
    box = shapely.box(0.8, -3.0, 2.2, 1.0)
    workspace = Workspace((-9.0, -9.0, 9.0, 9.0), (Obstacle("box", box),))
    path = np.array([[0.2, 1.8], [2.8, 1.8], [4.0, 0.5]])
    ends = np.vstack([np.zeros((1, 2)), path])
    lines = separating_lines(pack_pieces(workspace), ends[:-1], ends[1:], LINES, 10.0)
    task = reach_task(
        N,
        LINES,
        path_m=path,
        lines=lines,
        clearance_m=0.4,
        step_length_m=3.0,
        effort_s_m2=0.5,
        pivot_m=np.array([8.0, 0.0]),
        bounds_m=workspace.bounds_m,
    )
    polished = solved(nlp, task)
    swept = np.vstack([np.zeros(2), polished.path_m])
    clearance = swept_clearance_m(index_obstacles(workspace), swept)
    assert clearance.min() >= 0.4
    assert max(np.abs(polished.multipliers[f"line_{end}"]).max() for end in ("start", "end")) > 0.01


# Connectivity.


def test_a_slope_stops_the_path_where_the_bound_does(nlp):
    """Margin 6 - x with 2 dB asked for: x_3 = 4, and the multipliers balance the cost."""
    task = reach_task(
        N, LINES, margins=scored(slope_margins([-1.0, 0.0], 6.0)), bound=np.full(N, 2.0)
    )
    polished = solved(nlp, task)
    np.testing.assert_allclose(polished.path_m, 4.0 / 3.0 * ALONG, atol=1e-3)
    # d/dx_3: 2 effort step - rate + lambda * slope = 0, lambda negative at a lower bound.
    expected = 2.0 * 0.1 * 4.0 / 3.0 - 1.0
    assert polished.multipliers["connectivity"][-1] == pytest.approx(expected, abs=1e-3)
    assert np.abs(polished.multipliers["connectivity"][:-1]).max() < 1e-3
    assert polished.slack_db.size == 0


# Price of outage.


def outage_cost(task, flat):
    """The cost of a task in NumPy and SciPy, lengths rounded at a centimetre as the solver's."""
    n = len(task.path_m)
    q = np.vstack([task.start_m, flat.reshape(n, 2)])
    score = task.evaluate(q[1:]).scores.value
    outage = task.charge
    share = np.append(outage.share_before, outage.charged * norm.sf(score))
    lengths = np.hypot(np.linalg.norm(np.diff(q, axis=0), axis=1), STEP_ROUNDING_M)
    charged_m = (lengths * 0.5 * (share[1:] + share[:-1])).sum()
    effort = task.charge.effort_s_m2 * (np.diff(q, axis=0) ** 2).sum()
    to_pivot = np.hypot(np.linalg.norm(q[-1] - task.charge.pivot_m), PIVOT_ROUNDING_M)
    return effort + task.charge.rate_s_m * to_pivot + outage.price_s_m * charged_m


@pytest.mark.parametrize("chance", [1e-9, 0.3, 0.9])
@pytest.mark.parametrize("price", [0.5, 0.8])
def test_a_uniform_outage_shortens_steps(nlp, chance, price):
    """Where every metre costs price (1 - P) more, a step is (rate - that) / (2 effort) long."""
    task = reach_task(
        N,
        LINES,
        effort_s_m2=0.3,
        step_length_m=5.0,
        margins=scored(constant_margins(10.0), constant_margins(norm.ppf(chance))),
        outage=outage_of(N, price, 1.0 - chance),
    )
    polished = solved(nlp, task)
    length = (1.0 - price * (1.0 - chance)) / (2.0 * 0.3)
    # The rounding of lengths takes half a thousandth off the price of the shortest step here.
    np.testing.assert_allclose(polished.path_m, length * ALONG, atol=3e-3)


PRICED = {
    "effort_s_m2": 0.9,
    "rate_s_m": 3.0,
    "step_length_m": 5.0,
    "margins": scored(constant_margins(10.0), slope_margins([0.2, 0.6], -1.0)),
    "outage": outage_of(N, 2.0, 0.4),
    "pivot_m": np.array([9.0, 4.0]),
}


def test_the_priced_path_is_the_best_that_another_solver_finds(nlp):
    """Scores rise upwards: the path goes round by the better side, as BFGS has it."""
    task = reach_task(N, LINES, **PRICED)
    polished = solved(nlp, task)
    other = minimize(
        lambda flat: outage_cost(task, flat), task.path_m.ravel(), options={"gtol": 1e-7}
    )
    assert outage_cost(task, polished.path_m.ravel()) <= other.fun + 1e-6
    np.testing.assert_allclose(polished.path_m.ravel(), other.x, atol=2e-3)
    free = solved(nlp, changed(task, outage=outage_of(N)))
    assert (polished.path_m[:, 1] > free.path_m[:, 1] + 0.2).all()


def test_the_residual_of_a_priced_path_by_differences(nlp):
    """Gradient of the cost plus multipliers times the rows' Jacobian, by central differences."""
    shape = {"margins": scored(bowl_margins([2.0, 2.0], 9.0), bowl_margins([1.0, 2.0], 4.0))}
    priced = {"rate_s_m": 3.0, "outage": outage_of(N, 1.5, 0.5)}
    task = reach_task(N, LINES, **HARD | shape | priced)
    polished = solved(nlp, task, 1e-5)
    at = polished.path_m.ravel()

    def rows(flat):
        q = np.vstack([task.start_m, flat.reshape(N, 2)])
        lines = task.lines.normals[:, :, None] @ q[1:, None, :, None]
        starts = task.lines.normals[1:, :, None] @ q[1:-1, None, :, None]
        squares = (np.diff(q, axis=0) ** 2).sum(1)
        margins = task.evaluate(q[1:]).margins.value
        return np.concatenate([squares, lines.ravel(), starts.ravel(), margins])

    def slopes(function):
        return np.stack(
            [(function(at + h) - function(at - h)) / 2e-5 for h in 1e-5 * np.eye(2 * N)]
        )

    names = ("speed", "line_end", "line_start", "connectivity")
    multipliers = np.concatenate([polished.multipliers[name].ravel() for name in names])
    assert np.abs(multipliers).max() > 0.1
    lagrangian = slopes(lambda flat: outage_cost(task, flat)) + slopes(rows) @ multipliers
    np.testing.assert_allclose(lagrangian, 0.0, atol=1e-4)


# Residual and reuse.

HARD = {
    "margins": scored(bowl_margins([2.0, 2.0], 9.0)),
    "bound": np.full(N, 3.0),
    "lines": with_line(no_lines(N, LINES), 1, [-0.6, 0.8], 0.2),
    "pivot_m": np.array([9.0, 4.0]),
}


@pytest.mark.parametrize("which", [0, N, N + N * LINES, -1])
def test_a_perturbed_multiplier_shows_in_the_residual(nlp, monkeypatch, which):
    """Had the solver returned any row's multiplier wrong, the residual would say so."""
    call = path_nlp.call_nlp

    def wrong(*arguments):
        point = call(*arguments)
        multipliers = point.row_multipliers.copy()
        multipliers[which] += 0.3
        return replace(point, row_multipliers=multipliers)

    task = reach_task(N, LINES, **HARD)
    assert solved(nlp, task).kkt_residual < 1e-5
    monkeypatch.setattr(path_nlp, "call_nlp", wrong)
    assert polish_path(nlp, task).kkt_residual > 0.05


FAILURES = {
    "margins not a number": (
        {"margins": scored(constant_margins(np.nan))},
        Termination.NUMERICAL_FAILURE,
    ),
    "bound out of reach": ({"bound": np.full(N, 1e3)}, Termination.INFEASIBLE),
    "start not a number": ({"path_m": np.full((N, 2), np.nan)}, Termination.NUMERICAL_FAILURE),
    "start far off": (
        {"path_m": ALONG + np.array([0.0, 1e6]), "bounds_m": (-1e7, -1e7, 1e7, 1e7)},
        None,
    ),
    "lines that contradict each other": (
        {
            "lines": with_line(
                with_line(no_lines(N, LINES), 0, [0.0, 1.0], 1.5), 1, [0.0, -1.0], 1.5
            )
        },
        Termination.INFEASIBLE,
    ),
}


@pytest.mark.parametrize("name", FAILURES)
def test_a_failed_solve_leaves_nothing_behind(nlp, name):
    """The next solve is what it would have been, and the failed one is not taken for solved."""
    changes, termination = FAILURES[name]
    task = reach_task(N, LINES, **HARD)
    before = polish_path(nlp, task)
    failed = polish_path(nlp, changed(task, **changes))
    if termination is not None:
        assert failed.termination is termination
        assert failed.kkt_residual > 0.1
    assert same(polish_path(nlp, task), before)


def test_nothing_is_printed(nlp, capfd):
    """Not by a solve that works, nor by one that fails in any way: at the level of files."""
    goal_nlp(2, 1)
    polish_path(nlp, reach_task(N, LINES, **HARD))
    for changes, _ in FAILURES.values():
        polish_path(nlp, changed(reach_task(N, LINES, **HARD), **changes))
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err == ""
