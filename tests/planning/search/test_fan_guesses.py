"""Fans of paths: free, at full speed where they can be, past the station, and the best of them."""

from dataclasses import asdict, replace

import numpy as np
import pytest
import shapely
from terms_scene import LEARNING, context_of, scorer_of, terms_problem

from planopt.channel import Station, condition
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.programme import path_nlp
from planopt.planning.proof.verify import Verdict
from planopt.planning.search.fan_guesses import (
    DETOURS,
    HEADINGS,
    ONWARD,
    TURNS_RAD,
    FanGuesses,
    commands_via,
    fan_paths,
    rough_clearance,
)
from planopt.planning.search.local_ranking import LocalRanking
from planopt.world import inside_bounds, swept_clearance_m


def fan_of(horizon, position_m=None):
    """A fan from a place, its situation and ground."""
    problem = terms_problem(LEARNING, horizon=horizon)
    context, belief = context_of(problem)
    if position_m is not None:
        context = replace(context, state=np.asarray(position_m))
    _, ground = scorer_of(context, belief)
    rough = rough_clearance(problem, ground.index)
    return fan_paths(context, ground.index, rough, horizon), context, ground, rough


@pytest.mark.parametrize("position_m", [None, (16.9, 20.0), (1.0, 39.0)])
@pytest.mark.parametrize("horizon", [1, 5, 20])
def test_every_way_is_free(horizon, position_m):
    """By the exact distances, with the pad; no step is longer than allowed."""
    ways, context, ground, _ = fan_of(horizon, position_m)
    problem = context.problem
    assert ways.shape == (HEADINGS * (len(TURNS_RAD) if horizon > 1 else 1), horizon, 2)
    for way in ways:
        path = np.vstack([context.position_m, way])
        assert inside_bounds(problem.workspace, path).all()
        moved = np.linalg.norm(np.diff(path, axis=0), axis=1) > 0.0
        clear = swept_clearance_m(ground.index, path)
        assert (clear[moved] >= problem.constraints.clearance_m).all()
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= problem.step_length_m


def test_ways_go_on_at_a_wall():
    """From beside the obstacle straight ways at it turn aside instead of standing still."""
    ways, context, *_ = fan_of(10, (15.0, 20.0))
    ahead = ways[0]
    assert np.linalg.norm(ahead[-1] - context.position_m) > 3.0 * context.problem.step_length_m
    assert (np.linalg.norm(np.diff(ahead, axis=0), axis=1) > 0.0).sum() >= 7


START = np.array([3.0, 1.0])


def driven(turn, speed, longest):
    heading = np.cumsum(turn, axis=0)
    steps = longest * speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return START + np.cumsum(steps, axis=0).transpose(1, 0, 2)


@pytest.mark.parametrize("offset", [(5.0, -2.0), (-0.3, 0.2), (4.0, 0.0), (0.0, 0.0)])
def test_every_way_comes_to_the_place(offset):
    """At a step of its own; no step is too long; those that go on go apart, one waits."""
    place = START + offset
    commands = commands_via(START, place, 9, 2.0)
    assert commands is not None
    ways = driven(*commands, 2.0)
    away = np.linalg.norm(ways - place, axis=2)
    np.testing.assert_allclose(away.min(axis=1), 0.0, atol=1e-9)
    legs = np.diff(np.concatenate([np.tile(START, (len(ways), 1, 1)), ways], axis=1), axis=1)
    assert np.linalg.norm(legs, axis=2).max() <= 2.0 + 1e-9
    assert len(ways) == (1 + 2 * DETOURS) * (ONWARD + 1)
    assert (away[:, -1] < 1e-9).sum() == 1 + 2 * DETOURS


def test_out_of_reach_there_is_none():
    """Nor without steps left to go on, but the one straight there."""
    assert commands_via(START, START + [10.1, 0.0], 5, 2.0) is None
    commands = commands_via(START, START + [10.0, 0.0], 5, 2.0)
    assert commands is not None
    assert commands[0].shape == (5, 1)


INFORMATION = {"kind": "mapping", "form": "information"}


def plan_for(context, belief):
    scorer, ground = scorer_of(context, replace(belief, posterior=context.posterior))
    return HorizonPlanner(context.problem, ground).plan(context, scorer)


@pytest.mark.parametrize("horizon", [1, 8])
def test_ways_are_better_than_the_fan(horizon):
    problem = terms_problem(INFORMATION, horizon=horizon)
    context, belief = context_of(problem)
    scorer, ground = scorer_of(context, belief)
    search = FanGuesses(problem, ground)
    found = search.find_paths(context, [])
    rough = rough_clearance(problem, ground.index)
    fan = fan_paths(context, ground.index, rough, horizon)
    assert scorer.objective(found[0]) >= LocalRanking(context, fan)(fan).max() - 1e-9
    for way, again in zip(found, search.find_paths(context, []), strict=True):
        np.testing.assert_array_equal(way, again)


@pytest.mark.parametrize("terms", [(LEARNING,), (INFORMATION,)])
def test_centimetres_for_metres_give_the_scaled_plan(terms, monkeypatch):
    """All lengths a hundred times as long, path loss adapted; polished to the optimum."""
    monkeypatch.setattr(path_nlp, "SETTLED", {})
    context, belief = context_of(terms_problem(*terms))
    plan = plan_for(context, belief)
    problem, parameters = context.problem, context.posterior.parameters
    site = problem.stations[0].site

    def longer(station):
        x, y = station.position_m
        return Station((1e2 * x, 1e2 * y), 1e2 * station.height_m)

    robot, world = problem.robots[0], problem.workspace
    scaled = replace(
        problem,
        workspace=replace(
            world,
            bounds_m=tuple(1e2 * bound for bound in world.bounds_m),
            obstacles=tuple(
                replace(
                    obstacle,
                    polygon=shapely.transform(obstacle.polygon, lambda corners: 1e2 * corners),
                )
                for obstacle in world.obstacles
            ),
        ),
        robots=(replace(robot, speed_max_m_s=1e2 * robot.speed_max_m_s),),
        stations=(replace(problem.stations[0], **asdict(longer(site))),),
        constraints=replace(problem.constraints, clearance_m=1e2 * problem.constraints.clearance_m),
    )
    measured = context.posterior.measurements
    posterior = condition(
        replace(
            parameters,
            k_pl_db=parameters.k_pl_db + 20.0 * parameters.n_pl,
            decorrelation_m=1e2 * parameters.decorrelation_m,
            station=longer(parameters.station),
        ),
        replace(measured, positions_m=1e2 * measured.positions_m),
    )
    other = plan_for(
        replace(
            context,
            problem=scaled,
            posteriors=(posterior,),
            state=1e2 * context.state,
            region=replace(context.region, grid_m=1e2 * context.region.grid_m),
        ),
        belief,
    )
    assert other.verdict is Verdict.VERIFIED
    assert other.objective == pytest.approx(plan.objective, rel=5e-3)
    np.testing.assert_allclose(1e-2 * other.positions_m, plan.positions_m, atol=0.1)
