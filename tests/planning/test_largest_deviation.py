"""The baseline that goes where power is known least within a step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planopt import load, simulate
from planopt.planning.initial_data import prepare


def test_the_first_step_has_the_largest_deviation() -> None:
    """Of places as far as a step, by the exact posterior, up to the density of the search."""
    problem = load("fig3")
    planner = replace(problem.planner, name="largest_deviation", horizon=1, max_steps=1)
    problem = replace(problem, planner=planner)
    run = simulate(problem, seed=3)
    start, end = run.run.log.positions_m
    posterior = prepare(problem, 3).belief.posterior
    angle = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    reach = problem.step_length_m * np.linspace(0.05, 0.999, 20)
    places = start + (reach[:, None, None] * circle).reshape(-1, 2)
    from planopt.planning.scene import build_ground, free_ends

    free = free_ends(problem, build_ground(problem, start), start, places)
    best = posterior.predict(places[free]).deviation_db.max()
    assert posterior.predict(end[None]).deviation_db[0] >= 0.995 * best
