"""Realised costs against exact geometry, and the clairvoyant against closed forms."""

from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import LineString, box
from strip_scene import strip

from planopt import Problem
from planopt.channel.ground_truth import power_truth
from planopt.planning.initial_data import prepare
from planopt.planning.loop.metrics import clairvoyant_path, realised_cost_m
from planopt.planning.scene import build_scene

STEP_M = 6.0


PRICE = 10.0


COURIER = {"start_m": [5.0, 10.0], "goal_m": [55.0, 10.0], "speed_max_m_s": STEP_M}


def path_of(problem: Problem) -> tuple[np.ndarray, float]:
    """The clairvoyant's path and what it costs."""
    scene, prepared = build_scene(problem), prepare(problem, 0)
    path = clairvoyant_path(problem, scene.road_map, scene.index, prepared.truths)
    return path, realised_cost_m(problem, prepared.truths, path)


def test_holes_between_the_ends_of_steps_are_charged(tmp_path: Path) -> None:
    """Two metres out of contact every 6 m, all across the strip: no steps lead over them."""
    x = np.arange(0.5, 60.0)
    out = (x % STEP_M < 2.0) & (x > 6.0) & (x < 54.0)
    path, cost_m = path_of(strip(tmp_path, np.where(out, -100.0, -60.0), COURIER))
    assert path[0] == pytest.approx((5.0, 10.0)) and path[-1] == pytest.approx((55.0, 10.0))
    assert cost_m == pytest.approx(50.0 + PRICE * out.sum(), abs=1.0)


def test_it_goes_round_a_hole_if_that_is_cheaper(tmp_path: Path) -> None:
    """A hole that leaves 5 m free at one side: the taut way round its corners, to a few percent."""
    rows = np.full((20, 60), -60.0)
    rows[:15, 20:40] = -100.0
    _, cost_m = path_of(strip(tmp_path, rows, COURIER))
    taut_m = 20.0 + 2.0 * np.hypot(15.0, 5.0)
    assert taut_m <= cost_m <= 1.04 * taut_m


def test_realised_cost_against_exact_geometry(tmp_path: Path) -> None:
    """A crooked path over a random map: shapely's lengths within the cells out of contact."""
    generator = np.random.default_rng(3)
    rows = np.where(generator.random((20, 60)) < 0.4, -100.0, -60.0)
    problem = strip(tmp_path, rows, COURIER)
    truth = power_truth(np.arange(0.5, 60.0), np.arange(0.5, 20.0), rows)
    places = generator.uniform((1.0, 1.0), (59.0, 19.0), (12, 2))
    line = LineString(places)
    cells = [box(x, y, x + 1, y + 1) for y, x in np.argwhere(rows < -80.0)]
    outside_m = sum(line.intersection(cell).length for cell in cells)
    exact_m = line.length + PRICE * outside_m
    assert realised_cost_m(problem, [truth], places) == pytest.approx(exact_m, rel=5e-3)
    # The same path driven in other steps costs the same.
    corners = np.linalg.norm(np.diff(places, axis=0), axis=1).cumsum()
    stops = np.sort(np.concatenate([np.linspace(0.0, line.length, 40), corners[:-1]]))
    driven = np.array([line.interpolate(at).coords[0] for at in stops])
    assert realised_cost_m(problem, [truth], driven) == pytest.approx(exact_m, rel=5e-3)


def test_nobody_pays_less_than_the_clairvoyant(tmp_path: Path) -> None:
    """Random drives to the goal cost at least as much, but for what the lattice misses."""
    generator = np.random.default_rng(5)
    rows = np.where(generator.random((20, 60)) < 0.3, -100.0, -60.0)
    problem = strip(tmp_path, rows, COURIER)
    _, least_m = path_of(problem)
    truths = prepare(problem, 0).truths
    for _ in range(200):
        y = 10.0 + np.concatenate([[0.0], generator.uniform(-8.0, 8.0, 7), [0.0]])
        drive = np.column_stack([np.linspace(5.0, 55.0, 9), y])
        assert realised_cost_m(problem, truths, drive) >= 0.97 * least_m
