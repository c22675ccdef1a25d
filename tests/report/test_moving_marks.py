"""What moves, in pictures: discs where they are predicted, and how far everything keeps away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from apart_scene import apart_problem
from artists import collection_of, drawn, legend_of, line_of, panel_of

from planopt import load, solve
from planopt.planning.loop.closed_loop import simulate
from planopt.report.result_figures import draw_plan, draw_team_plan, draw_team_run
from planopt.world.least_distance import closest_approach_m
from planopt.world.moving_obstacle import MovingObstacle, centres_at, growth_m

LABEL, TITLE = "moving obstacle, paler later", "least distance"


@pytest.fixture(scope="module")
def run():
    """Two robots beside a cart, four steps."""
    return simulate(apart_problem([(10, 15), (14, 15)], max_steps=4, horizon=3), seed=0)


def circles(panel, label):
    """Centres and radii of a collection of discs."""
    boxes = [path.get_extents() for path in collection_of(panel, label).get_paths()]
    return [((b.x0 + b.x1) / 2, (b.y0 + b.y1) / 2, b.width / 2) for b in boxes]


def test_a_run_shows_where_the_cart_was_and_how_far_all_kept_away(run):
    """Discs of true size at every step; curves of the least distances, and what was asked."""
    figure = drawn(draw_team_run(run))
    (cart,) = run.problem.workspace.moving
    places = centres_at(cart, run.runs[0].log.t_s)
    expected = [(*place, cart.radius_m) for place in places.tolist()]
    np.testing.assert_allclose(circles(figure.axes[0], LABEL), expected, atol=1e-3)
    assert LABEL in legend_of(figure)
    panel = panel_of(figure, TITLE)
    a, b = (one.log.positions_m for one in run.runs)
    apart = line_of(panel, "two robots").get_ydata()
    np.testing.assert_allclose(apart[1:], closest_approach_m(a[:-1], a[1:], b[:-1], b[1:]))
    assert min(apart) == run.metrics["min_separation_m"]
    away = line_of(panel, "moving obstacle").get_ydata()
    assert min(away) == run.metrics["min_moving_clearance_m"]
    levels = [line.get_ydata()[0] for line in panel.lines if line.get_linestyle() == "--"]
    assert levels == [3.0, 0.5]


def test_plans_show_the_discs_as_large_as_predicted():
    """The rim grows with the time ahead."""
    problem = apart_problem([(10, 15), (14, 15)], max_steps=4, horizon=3)
    cart = replace(problem.workspace.moving[0], position_std_m=0.1, acceleration_std_m_s2=0.1)
    problem = replace(problem, workspace=replace(problem.workspace, moving=(cart,)))
    solved = solve(problem, seed=0)
    target = solved.aims[0].target_m
    figure = drawn(draw_team_plan(problem, solved.plans, solved.belief, target))
    ground = figure.axes[0]
    rims = [part for part in ground.collections if part.get_linestyle()[0][1] is not None]
    radii = [
        path.get_extents().width / 2
        for part in rims
        for path in part.get_paths()
        if part.get_label() != LABEL
    ]
    times = solved.plans[0].t_s
    expected = cart.radius_m + growth_m(cart, times)
    assert all(np.isclose(radii, size, atol=1e-3).any() for size in expected)
    assert panel_of(figure, TITLE) is not None


def test_nothing_moves_in_pictures_of_problems_where_nothing_does():
    """Neither discs nor a panel; and one robot's plan has them where it does."""
    problem = load("open_field")
    solved = solve(problem, horizon=2)
    assert LABEL not in legend_of(drawn(draw_plan(solved)))
    cart = MovingObstacle("cart", 1.0, (0.0,), ((30.0, 40.0),), (0.1, 0.1))
    beside = replace(problem, workspace=replace(problem.workspace, moving=(cart,)))
    figure = drawn(draw_plan(replace(solved, problem=beside)))
    assert LABEL in legend_of(figure)
    assert len(circles(figure.axes[0], LABEL)) == 3
