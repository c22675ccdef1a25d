"""The clairvoyant against holes that equal steps fall into, and against a closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planopt.planning.loop.clairvoyant import clairvoyant_path, realised_cost_m
from planopt.planning.prepare import prepare
from planopt.planning.scene import build_scene
from planopt.problems.load import problem_from_tables
from planopt.problems.problem import Problem

STEP_M = 6.0


def strip(folder: Path, gain_db: np.ndarray) -> Problem:
    """A free strip of 60 m by 20 m whose power depends on x alone; 50 m from start to goal."""
    x, y = np.arange(0.5, 60.0), np.arange(0.5, 20.0)
    rows = np.tile(gain_db, (len(y), 1))
    np.savez(folder / "strip.npz", path_gain_db=rows, x=x, y=y)
    tables = {
        "problem": {"schema": 1, "name": "strip", "task": "reach"},
        "world": {"bounds_m": [0.0, 0.0, 60.0, 20.0]},
        "channel": {
            "truth": {
                "kind": "raster",
                "file": "strip.npz",
                "variable": "path_gain_db",
                "floor_db": -130.0,
            },
            "measurements": {"count": 60},
        },
        "robots": [{"start_m": [5.0, 10.0], "goal_m": [55.0, 10.0], "speed_max_m_s": STEP_M}],
        "stations": [
            {
                "position_m": [30.0, 10.0],
                "height_m": 3.0,
                "transmit_power_dbm": 0.0,
                "threshold_dbm": -80.0,
            }
        ],
        "constraints": {"p_min": 0.8, "clearance_m": 0.5, "goal_radius_m": 1.0},
        "planner": {"horizon": 5, "step_s": 1.0},
    }
    return problem_from_tables(tables, folder=folder, file=None)


def path_of(problem: Problem) -> tuple[np.ndarray, float]:
    """The clairvoyant's path and what it costs."""
    scene, prepared = build_scene(problem), prepare(problem, 0)
    path = clairvoyant_path(problem, scene.road_map, scene.index, prepared.truths)
    return path, realised_cost_m(problem, prepared.truths, path)


def test_it_steps_over_holes_shorter_than_a_step(tmp_path: Path) -> None:
    """Two metres out of contact wherever equal steps of 6 m end: its own steps end beside them."""
    x = np.arange(0.5, 60.0)
    phase = (x - 5.0 + STEP_M / 2) % STEP_M - STEP_M / 2
    gain = np.where((np.abs(phase) <= 1.0) & (x > 6.0), -100.0, -60.0) + 1e-3 * x
    path, cost_m = path_of(strip(tmp_path, gain))
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert lengths.max() <= STEP_M
    assert path[0] == pytest.approx((5.0, 10.0)) and path[-1] == pytest.approx((55.0, 10.0))
    assert cost_m == pytest.approx(lengths.sum())
    assert lengths.sum() < 1.1 * 50.0


def test_cost_of_a_connected_straight_way(tmp_path: Path) -> None:
    """Without a hole it is the straight way and its length."""
    _, cost_m = path_of(strip(tmp_path, np.linspace(-50.0, -60.0, 60)))
    assert cost_m == pytest.approx(50.0, rel=1e-9)


def test_cost_of_one_wide_hole(tmp_path: Path) -> None:
    """A hole of 20 m across the whole strip: 10 more for each of its metres, but for a step."""
    x = np.arange(0.5, 60.0)
    _, cost_m = path_of(strip(tmp_path, np.where((x > 20.0) & (x < 40.0), -100.0, -60.0)))
    assert 50.0 + 10.0 * (20.0 - 2 * STEP_M) <= cost_m <= 50.0 + 10.0 * (20.0 + STEP_M)
