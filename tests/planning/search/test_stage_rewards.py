"""Rewards of lattice nodes: those of the path's worth, cut off where nothing is known."""

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import LEARNING, TRACKING, context_of, scorer_of, terms_problem

from planopt.planning.search.guess_search import StageRewards
from planopt.planning.search.node_margins import NodeField
from planopt.planning.values.objective_value import Guide, ObjectiveValue


def rewards_of(problem, reach_m=6.0):
    """Rewards about the start, the field and the situation."""
    context, belief = context_of(problem)
    _, ground = scorer_of(context, belief)
    field = NodeField(ground.road_map.lattice)
    field.refresh(context, reach_m)
    count = problem.planner.horizon
    guide = Guide(
        problem.constraints.p_min, np.full(count, problem.constraints.p_min > 0.0), np.zeros(count)
    )
    return StageRewards(context, field, guide), field, context


def nodes_near(field, count=5):
    """Nodes (count, 2) near the middle of what is in reach, free of the obstacle."""
    rows, columns = field.window
    row, column = (rows.start + rows.stop) // 2, (columns.start + columns.stop) // 2
    return np.column_stack([row + np.arange(count) - 2, np.full(count, column - 1)])


def test_rewards_along_a_path_are_the_windows_and_its_worth():
    """Stage by stage; with good predictions at the nodes their sum is the path's worth."""
    rewards, field, context = rewards_of(terms_problem(TRACKING))
    nodes = nodes_near(field)
    windows = [
        rewards(k + 1, (slice(row, row + 1), slice(column, column + 1)))[0, 0]
        for k, (row, column) in enumerate(nodes)
    ]
    np.testing.assert_allclose(rewards.along(nodes), windows, rtol=1e-12)
    assert field.correct(nodes)
    assert not field.correct(nodes)
    rewards.corrected(nodes)
    worth = ObjectiveValue(context)(field.places_m(nodes))
    assert rewards.along(nodes).sum() == pytest.approx(worth, rel=1e-9)


@pytest.mark.parametrize("terms", [(TRACKING,), (TRACKING, LEARNING)])
def test_a_step_that_misses_the_bound_costs_more_than_all_can_gain(terms):
    problem = terms_problem(*terms, p_min=0.9)
    radio = replace(problem.stations[0], threshold_dbm=-33.0)
    rewards, field, _ = rewards_of(replace(problem, stations=(radio,)))
    everywhere = field.window
    worth = rewards(1, everywhere)
    finite = worth[np.isfinite(worth)]
    kept = finite[finite >= 0.0]
    missed = finite[finite < 0.0]
    assert len(kept) and len(missed)
    assert kept.max() * problem.planner.horizon + missed.max() <= 0.0
