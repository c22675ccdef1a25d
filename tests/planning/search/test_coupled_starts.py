"""Starts where terms couple places, and the plans that come of them."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
import shapely
from terms_scene import LEARNING, judge_of, situation_of, terms_problem

from planopt.channel.parameters import Station
from planopt.channel.posterior import condition
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.programme import path_nlp
from planopt.planning.proof.verify import Verdict
from planopt.planning.search.fan_guesses import FanGuesses, fan_paths, rough_clearance
from planopt.planning.search.local_ranking import LocalRanking

INFORMATION = {"kind": "mapping", "form": "information"}


def plan_for(situation, belief):
    """The plan from a situation."""
    judge, ground = judge_of(situation, replace(belief, posterior=situation.posterior))
    return HorizonPlanner(situation.problem, ground).plan(situation, judge)


@pytest.mark.parametrize("horizon", [1, 8])
def test_ways_are_better_than_the_fan(horizon):
    """And sound, and the same each time."""
    problem = terms_problem(INFORMATION, horizon=horizon)
    situation, belief = situation_of(problem)
    judge, ground = judge_of(situation, belief)
    search = FanGuesses(problem, ground)
    found = search.find_paths(situation, [])
    rough = rough_clearance(problem, ground.index)
    fan = fan_paths(situation, ground.index, rough, horizon)
    assert judge.objective(found[0]) >= LocalRanking(situation, fan)(fan).max() - 1e-9
    for way, again in zip(found, search.find_paths(situation, []), strict=True):
        np.testing.assert_array_equal(way, again)


@pytest.mark.parametrize("terms", [(LEARNING,), (INFORMATION,)])
def test_a_redundant_obstacle_changes_nothing(terms):
    """One inside another obstacle, or beyond all steps."""
    situation, belief = situation_of(terms_problem(*terms))
    plan = plan_for(situation, belief)
    workspace = situation.problem.workspace
    known = workspace.obstacles[0]
    more = (
        replace(known, name="inner", polygon=shapely.box(19.0, 15.0, 21.0, 20.0)),
        replace(known, name="far", polygon=shapely.box(36.0, 36.0, 38.0, 38.0)),
    )
    problem = replace(
        situation.problem,
        workspace=replace(workspace, obstacles=(*workspace.obstacles, *more)),
    )
    other = plan_for(replace(situation, problem=problem), belief)
    np.testing.assert_allclose(other.positions_m, plan.positions_m, atol=1e-6)


@pytest.mark.parametrize("terms", [(LEARNING,), (INFORMATION,)])
def test_centimetres_for_metres_give_the_scaled_plan(terms, monkeypatch):
    """All lengths a hundred times as long, path loss adapted; polished to the optimum."""
    monkeypatch.setattr(path_nlp, "SETTLED", {})
    situation, belief = situation_of(terms_problem(*terms))
    plan = plan_for(situation, belief)
    problem, parameters = situation.problem, situation.posterior.parameters
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
    measured = situation.posterior.measurements
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
            situation,
            problem=scaled,
            posteriors=(posterior,),
            state=1e2 * situation.state,
            region=replace(situation.region, grid_m=1e2 * situation.region.grid_m),
        ),
        belief,
    )
    assert other.verdict is Verdict.VERIFIED
    assert other.objective == pytest.approx(plan.objective, rel=5e-3)
    np.testing.assert_allclose(1e-2 * other.positions_m, plan.positions_m, atol=0.1)
