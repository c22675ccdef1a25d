"""Robots that drifted to where they must not be are led away, and say so."""

import numpy as np
import pytest
import shapely
from scenes import small_problem

from planopt import InputError, Planner, Verdict, load
from planopt.extend import Rung
from planopt.planning.free_space import leaving_path
from planopt.world import NOTHING_MOVES, index_obstacles

HOUSE = shapely.box(18.0, 10.0, 22.0, 20.0)
PROBLEM = small_problem(HOUSE)
INDEX = index_obstacles(PROBLEM.workspace)


def left(place, problem=PROBLEM):
    return leaving_path(problem, INDEX, NOTHING_MOVES, np.array(place))


@pytest.mark.parametrize("place", [(17.51, 15.0), (17.9, 9.95), (22.499, 19.0), (20.0, 20.2)])
def test_leads_away_in_one_step(place):
    """It ends clear, comes no nearer on the way, is no longer than a step, and stands then."""
    path = left(place)
    assert path is not None and np.ptp(path, axis=0).max() == 0.0
    shares = np.linspace(0.0, 1.0, 50)[:, None]
    way = shapely.points(np.array(place) + shares * (path[0] - place))
    away = shapely.distance(way, HOUSE)
    assert away[-1] >= PROBLEM.constraints.clearance_m
    assert away.min() >= away[0] - 1e-6
    assert np.linalg.norm(path[0] - place) <= PROBLEM.step_length_m


def test_leads_back_into_bounds():
    """To a place inside, by a move no longer than needed: one of the lengths tried."""
    path = left((-0.3, 5.0))
    assert path is not None
    assert path[0, 0] >= 0.0 and path[0, 0] <= PROBLEM.step_length_m / 4.0


def test_stays_where_nothing_is_wrong():
    """Nor where no move is better: amid walls that are too near on all sides."""
    assert left((10.0, 10.0)) is None
    walls = shapely.box(0.0, 0.0, 4.0, 4.0) - shapely.box(1.9, 1.9, 2.1, 2.1)
    cell = small_problem(walls)
    index = index_obstacles(cell.workspace)
    assert leaving_path(cell, index, NOTHING_MOVES, np.array([2.0, 2.0])) is None


@pytest.mark.parametrize(
    ("name", "place"),
    [("open_field", (65.499, 50.0)), ("open_field", (119.999, 50.0)), ("outdoor_map", None)],
)
def test_a_loop_goes_on_after_drift(name, place):
    """A step away that is violated, then verified plans; a place out of bounds is led back."""
    problem = load(name)
    if place is None:
        west, low, _, high = problem.workspace.obstacles[0].polygon.bounds
        place = (west - problem.constraints.clearance_m + 1e-3, 0.5 * (low + high))
    if place[0] > 100.0:
        place = (problem.workspace.bounds_m[2] + 0.02, place[1])
    planner = Planner(problem, horizon=3)
    states = [robot.start_state for robot in problem.robots]
    states[0] = np.array(place)
    first = planner.step_all(states)
    assert (first[0].rung, first[0].verdict) == (Rung.LEAVE, Verdict.VIOLATED)
    again = planner.step_all([plan.next_state for plan in first])
    assert again[0].verdict is Verdict.VERIFIED


def test_a_step_out_of_bounds_is_another_frame():
    """Farther out than a step, the place is refused."""
    problem = load("open_field")
    far = problem.workspace.bounds_m[2] + 1.1 * problem.step_length_m
    with pytest.raises(InputError, match=r"outside world\.bounds_m"):
        Planner(problem, horizon=2).step((far, 50.0))
