"""Paths beside others in space and time, against a search by brute force."""

import numpy as np
import pytest
import shapely
from scenes import context_of, search_of, small_problem

from planopt.planning.scene import first_moves
from planopt.world import MovingDiscs

STREET = (shapely.box(8, 0, 32, 13), shapely.box(8, 17, 32, 30))
LEAST_M = 4.0
STEPS = 260


def disc(places_m):
    """Another robot at these places, then standing."""
    places = np.asarray(places_m, dtype=float)
    places = places[np.minimum(np.arange(STEPS + 1), len(places) - 1)]
    return MovingDiscs(
        ("other",), places[None], np.zeros((1, STEPS)), np.array([LEAST_M]), np.array([True])
    )


def found_beside(problem, discs):
    """The start alone, and what is found beside discs."""
    search, belief, _ = search_of(problem)
    here = np.asarray(problem.robots[0].start_m)
    start = search.find_start(context_of(problem, belief, here))
    return start, search.clear_course(here, start, discs)


def least_m(places_m, discs):
    """Least distance from the disc by sampling."""
    share = np.linspace(0.0, 1.0, 41)[:, None, None]
    apart = places_m - discs.centres_m[0][: len(places_m)]
    return np.linalg.norm((1 - share) * apart[:-1] + share * apart[1:], axis=2).min()


def steps_by_force(problem, discs, most):
    """Fewest lattice steps to the goal beside a disc, by sets of places; None up to `most`."""
    _, _, scene = search_of(problem)
    places, sources = scene.road_map.nodes_m, scene.road_map.sources
    start = np.asarray(problem.robots[0].start_m)
    nodes, _ = first_moves(scene, problem, start)
    # The others in these tests are far away in the first step.
    reached = set(nodes.tolist())
    for step in range(1, most):
        if scene.goal_node in reached:
            return step
        ends = np.array([(a, b) for a in reached for b in sources[a] if b < len(places)])
        share = np.linspace(0.0, 1.0, 41)[:, None, None]
        way = (1 - share) * places[ends[:, 0]] + share * places[ends[:, 1]]
        centre = (1 - share) * discs.centres_m[0, step] + share * discs.centres_m[0, step + 1]
        clear = np.linalg.norm(way - centre, axis=2).min(axis=0) >= LEAST_M + 1e-3
        reached = set(ends[clear, 1].tolist())
    return None


@pytest.mark.parametrize(
    "other",
    [
        [(20 - 0.5 * k, 15) for k in range(60)],
        [(30 - 1.5 * k, 15) for k in range(20)],
        [(14, 15)] * 25 + [(14, 15 - 2 * k) for k in range(1, 4)],
    ],
    ids=["slowly towards it", "fast towards it", "in the way for long"],
)
def test_takes_no_longer_than_a_search_by_force(other):
    """The goal can be reached beside the other one, and as early as on the lattice."""
    problem = small_problem(start_m=(5.0, 15.0), goal_m=(31.0, 15.0), bounds_m=(0, 0, 36, 30))
    discs = disc(other)
    _, (start, places, path) = found_beside(problem, discs)
    assert path.arrives and start.gives_way
    assert np.array_equal(start.path_m, places[1 : 1 + len(start.path_m)])
    assert least_m(places, discs) >= LEAST_M
    away = np.linalg.norm(places - problem.goal_m, axis=1)
    fewest = steps_by_force(problem, discs, 60)
    assert fewest is not None
    # The route at the end is driven at full speed, not by moves: it may be a little sooner.
    arrived = int(np.flatnonzero(away > problem.constraints.goal_radius_m)[-1]) + 1
    assert fewest - 4 <= arrived <= fewest + 1


def test_waits_aside_where_the_other_stays_in_the_way():
    """A street that is shut for good: the path leads to where nobody is met."""
    problem = small_problem(*STREET, start_m=(12.0, 15.0), goal_m=(36.0, 15.0))
    discs = disc([(28 - 2 * k, 15) for k in range(4)])
    _, (_, places, path) = found_beside(problem, discs)
    assert not path.arrives
    assert least_m(places, discs) >= LEAST_M
    assert np.array_equal(places[-1], places[len(path.nodes)])


def test_none_where_the_other_drives_over_it():
    """From a dead end that the other one drives into there is no way out."""
    shut = shapely.box(31, 0, 33, 30)
    problem = small_problem(*STREET, shut, start_m=(29.0, 15.0), goal_m=(5.0, 15.0))
    assert found_beside(problem, disc([(22 + k, 15) for k in range(8)]))[1] is None
