"""Fans of ways: free, at full speed where they can be, and going on where they are blocked."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from terms_scene import LEARNING, judge_of, situation_of, terms_problem

from planopt.planning.search.fan_guesses import (
    HEADINGS,
    TURNS_RAD,
    driven_paths,
    fan_paths,
    rough_clearance,
)
from planopt.world.clearance import clearance_m, inside_bounds, swept_clearance_m


def fan_of(horizon, position_m=None):
    """A fan from a place, its situation and ground."""
    problem = terms_problem(LEARNING, horizon=horizon)
    situation, belief = situation_of(problem)
    if position_m is not None:
        situation = replace(situation, state=np.asarray(position_m))
    _, ground = judge_of(situation, belief)
    rough = rough_clearance(problem, ground.index)
    return fan_paths(situation, ground.index, rough, horizon), situation, ground, rough


@pytest.mark.parametrize("position_m", [None, (16.9, 20.0), (1.0, 39.0)])
@pytest.mark.parametrize("horizon", [1, 5, 20])
def test_every_way_is_free(horizon, position_m):
    """By the exact distances, with the pad; no step is longer than allowed."""
    ways, situation, ground, _ = fan_of(horizon, position_m)
    problem = situation.problem
    assert ways.shape == (HEADINGS * (len(TURNS_RAD) if horizon > 1 else 1), horizon, 2)
    for way in ways:
        path = np.vstack([situation.position_m, way])
        assert inside_bounds(problem.workspace, path).all()
        moved = np.linalg.norm(np.diff(path, axis=0), axis=1) > 0.0
        clear = swept_clearance_m(ground.index, path)
        assert (clear[moved] >= problem.constraints.clearance_m).all()
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= problem.step_length_m


def test_ways_in_the_open_are_straight_and_even_arcs():
    """Nothing is in the way: at full speed, the turn the same at every step."""
    ways, situation, *_ = fan_of(3, (8.0, 20.0))
    legs = np.diff(np.concatenate([np.full((len(ways), 1, 2), [8.0, 20.0]), ways], axis=1), axis=1)
    np.testing.assert_allclose(
        np.linalg.norm(legs, axis=2), situation.problem.step_length_m, atol=1e-5
    )
    heading = np.unwrap(np.arctan2(legs[..., 1], legs[..., 0]), axis=1)
    turn = np.diff(heading, axis=1)
    wanted = np.repeat(math.pi * np.asarray(TURNS_RAD) / 2.0, HEADINGS)
    np.testing.assert_allclose(turn, np.column_stack([wanted, wanted]), atol=1e-9)


def test_ways_go_on_at_a_wall():
    """From beside the obstacle straight ways at it turn aside instead of standing still."""
    ways, situation, *_ = fan_of(10, (15.0, 20.0))
    ahead = ways[0]
    assert np.linalg.norm(ahead[-1] - situation.position_m) > 3.0 * situation.problem.step_length_m
    assert (np.linalg.norm(np.diff(ahead, axis=0), axis=1) > 0.0).sum() >= 7


def test_slow_ways_are_short():
    """Speed is a share of the largest."""
    _, situation, ground, rough = fan_of(4)
    turn, speed = np.zeros((4, 1)), np.array([[1.0], [0.5], [0.0], [0.25]])
    way = driven_paths(situation, ground.index, rough, turn, speed)[0]
    np.testing.assert_allclose(
        way[:, 0] - situation.position_m[0], 2.0 * np.cumsum(speed[:, 0]), atol=1e-5
    )


def test_rough_clearance_is_near_the_exact_one():
    """Within a cell of it, and false beyond the bounds."""
    *_, ground, rough = fan_of(1)
    places = np.random.default_rng(0).uniform(0.0, 40.0, (500, 2))
    exact = clearance_m(ground.index, places)
    for wanted in (0.5, 2.0):
        free = rough.is_free(places, wanted)
        assert free[exact > wanted + rough.cell_m].all()
        assert not free[exact < wanted - rough.cell_m].any()
    assert not rough.is_free(np.array([[-0.1, 5.0], [5.0, 40.1]]), 0.0).any()
    assert rough.is_free(np.array([[0.0, 0.0], [40.0, 40.0]]), 0.5).all()
