"""Robots that learn or map measure after nearly every step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from planopt.planning.loop.closed_loop import simulate
from planopt.problems.load import load, with_overrides

PROBLEMS = Path(__file__).parents[3] / "benchmarks" / "problems"
STEPS = 20


@pytest.mark.parametrize("horizon", [1, 5])
@pytest.mark.parametrize(
    "name",
    ["indoor_learn", "outdoor_map", PROBLEMS / "hall_learn.toml", PROBLEMS / "yard_map.toml"],
    ids=lambda name: Path(name).stem,
)
def test_nearly_every_step_measures(name, horizon):
    """At least 95 %, where unmeasured places remain all the time."""
    problem = with_overrides(load(name), horizon=horizon)
    problem = replace(problem, planner=replace(problem.planner, max_steps=STEPS))
    run = simulate(problem, seed=3)
    assert run.runs[0].outcome.value == "completed"
    assert run.metrics["measured_steps"] >= 0.95 * STEPS


def test_the_two_layer_form_reaches_what_it_steers_to():
    """One step ahead it crosses the yard instead of circling a node of the lattice."""
    problem = load(PROBLEMS / "yard_two_layer.toml")
    run = simulate(problem, seed=3)
    places = run.runs[0].log.positions_m
    assert run.metrics["path_m"] > 0.9 * problem.planner.max_steps * problem.step_length_m
    assert (places.max(axis=0) - places.min(axis=0)).min() > 15.0
