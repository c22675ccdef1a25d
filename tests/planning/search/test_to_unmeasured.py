"""Robots in the middle of what they have measured drive out of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from terms_scene import ENERGY, TRACKING, context_of, scorer_of, terms_problem

from planopt import Obstacle, Verdict
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.planners import OneStepPlanner
from planopt.planning.scene import PathsFrom
from planopt.planning.search.place_paths import path_to_unmeasured
from planopt.planning.solve import simulate
from planopt.world import swept_clearance_m

INFORMATION = {"kind": "mapping", "form": "information"}
BETWEEN = np.array([15.0, 20.0])
"""West of the obstacle, which reaches from (18, 12) to (22, 28)."""


def scene(*terms, spacing_m=7.0, **planner):
    """Problem, context, scorer and ground, the robot at `BETWEEN` on a measurement of its own."""
    problem = terms_problem(*(terms or (INFORMATION,)), **planner)
    channel = replace(problem.channel, measure_spacing_m=spacing_m)
    robot = replace(problem.robots[0], start_m=tuple(BETWEEN))
    problem = replace(problem, channel=channel, robots=(robot,))
    context, belief = context_of(problem)
    return problem, context, *scorer_of(context, belief)


def test_the_way_leads_to_an_open_place_and_is_short():
    """Every step clear and no longer than allowed; what it leads to brings a measurement."""
    problem, context, _, ground = scene(horizon=12)
    way = path_to_unmeasured(context, ground)
    assert way.shape == (12, 2)
    whole = np.vstack([BETWEEN, way])
    assert np.linalg.norm(np.diff(whole, axis=0), axis=1).max() <= problem.step_length_m
    assert swept_clearance_m(ground.index, whole).min() >= problem.constraints.clearance_m
    taken = context.measuring.takes(way)
    assert taken.any() and not context.measuring.takes(way[:1]).any()
    nodes = ground.road_map.nodes_m
    lengths = PathsFrom(problem, ground, BETWEEN).length_m[context.measuring.is_open(nodes)]
    fewest = np.ceil(lengths.min() / problem.step_length_m)
    assert int(taken.argmax()) + 1 <= fewest + 2


@pytest.mark.parametrize("planner", [HorizonPlanner, OneStepPlanner])
@pytest.mark.parametrize("horizon", [1, 3])
def test_plans_that_cannot_measure_lead_out(planner, horizon):
    """Verified, and nearer to what is open, instead of standing where nothing is worth anything."""
    name = "one_step" if planner is OneStepPlanner else "auto"
    problem, context, scorer, ground = scene(horizon=horizon, name=name)
    plan = planner(problem, ground).plan(context, scorer)
    assert plan.verdict is Verdict.VERIFIED
    assert plan.objective == 0.0
    assert 1.5 < np.linalg.norm(plan.positions_m[1] - BETWEEN) <= 2.0
    nodes = ground.road_map.nodes_m[context.measuring.is_open(ground.road_map.nodes_m)]
    away = [np.linalg.norm(nodes - place, axis=1).min() for place in plan.positions_m]
    assert away[1] < away[0] and away[-1] <= away[1]


def test_other_terms_decide_for_themselves():
    """Who tracks a target as well is not sent away from it."""
    problem, context, _, ground = scene(TRACKING, INFORMATION, horizon=1)
    planner = HorizonPlanner(problem, ground)
    assert planner._exit_path(context, []) is None
    problem, context, _, ground = scene(INFORMATION, ENERGY, horizon=1)
    assert HorizonPlanner(problem, ground)._exit_path(context, []) is not None


def test_with_all_measured_there_is_no_way():
    """Also where what is left cannot be come to."""
    problem, context, _, ground = scene(spacing_m=100.0)
    assert path_to_unmeasured(context, ground) is None
    walls = tuple(
        Obstacle(f"wall {k}", box)
        for k, box in enumerate(
            [
                shapely.box(8.0, 8.0, 9.0, 32.0),
                shapely.box(8.0, 31.0, 24.0, 32.0),
                shapely.box(23.0, 8.0, 24.0, 32.0),
                shapely.box(8.0, 8.0, 24.0, 9.0),
            ]
        )
    )
    closed = replace(problem, workspace=replace(problem.workspace, obstacles=walls))
    context, belief = context_of(replace(closed, channel=scene()[0].channel))
    _, ground = scorer_of(context, belief)
    places = np.stack(np.meshgrid(np.arange(8.0, 25.0), np.arange(8.0, 33.0)), axis=-1)

    some = context.posterior.measurements
    everywhere = some.take(np.zeros(places.size // 2, dtype=np.intp))
    inside = SimpleNamespace(
        measurements=replace(everywhere, positions_m=places.reshape(-1, 2)),
        parameters=context.posterior.parameters,
    )
    hemmed = replace(context, posteriors=(inside,))
    assert path_to_unmeasured(hemmed, ground) is None
    assert context.measuring.is_open(ground.road_map.nodes_m).any()


@pytest.mark.parametrize("horizon", [1, 4])
def test_a_spacing_longer_than_a_step_is_measured_again_and_again(horizon):
    """Two steps of 2 m each for a spacing of 3 m: every second step brings one, nothing stalls."""
    problem, *_ = scene(spacing_m=3.0, horizon=horizon, max_steps=16)
    run = simulate(problem, seed=2)
    assert run.runs[0].outcome.value == "completed"
    assert run.metrics["measured_steps"] >= 6
    assert run.metrics["path_m"] > 25.0
