"""Gaps: how they are weighted, measured around, closed, and crossed in the end."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import small_problem

from planopt.planning.scene import build_scene
from planopt.planning.search.frontier import CLOSED_FACTOR, OUT_OF_BOUND_FACTOR, Frontier
from planopt.planning.search.road_map import shortest_ways

NOTHING = np.zeros((0, 2))


class Street:
    """A street of 28 x 6 m with a gap from x = 10 to 14, and a robot at its left."""

    def __init__(self) -> None:
        problem = small_problem(
            bounds_m=(0.0, 0.0, 28.0, 6.0), start_m=(3.0, 3.0), goal_m=(25.0, 3.0)
        )
        self.scene = build_scene(problem)
        self.road_map = self.scene.road_map
        x = self.road_map.nodes_m[:, 0]
        self.outside = (x > 10.0) & (x < 14.0)
        self.frontier = Frontier(self.road_map, problem.step_length_m)

    def node_at(self, x: float, y: float) -> int:
        """The nearest node."""
        return int(np.argmin(np.linalg.norm(self.road_map.nodes_m - (x, y), axis=1)))

    def ways(self):
        """Ways to the goal, the gap weighted."""
        factor = self.frontier.node_factor(self.outside)
        return shortest_ways(self.road_map, self.scene.goal_node, factor)

    def ways_from(self, node: int):
        """Ways from a node."""
        return shortest_ways(self.road_map, node, self.frontier.node_factor(self.outside))


@pytest.fixture
def street() -> Street:
    """A new one."""
    return Street()


def test_metres_below_the_bound_cost_more(street):
    """A hundred times, and one elsewhere."""
    factor = street.frontier.node_factor(street.outside)
    assert (factor[street.outside] == OUT_OF_BOUND_FACTOR).all()
    assert (factor[~street.outside] == 1.0).all()
    assert not street.frontier.probing and not street.frontier.crossing


def test_no_gap_on_the_way(street):
    """From behind the gap nothing stands between."""
    assert not street.frontier.stand_before_gap(
        street.ways(), street.node_at(20.0, 3.0), street.outside
    )
    assert not street.frontier.probing


def test_probes_are_near_unmeasured_and_within_the_bound(street):
    """The nearest such node on this side, until all are measured."""
    here = street.node_at(9.0, 3.0)
    assert street.frontier.stand_before_gap(street.ways(), here, street.outside)
    assert street.frontier.probing
    measured, probes = NOTHING, []
    while True:
        probe = street.frontier.probe(street.ways_from(here), measured, street.outside)
        if probe is None:
            break
        place = street.road_map.nodes_m[probe]
        assert not street.outside[probe]
        assert place[0] < 10.0
        assert len(measured) == 0 or np.linalg.norm(measured - place, axis=1).min() >= 1.0 - 1e-9
        measured = np.vstack([measured, place])
        probes.append(probe)
        assert len(probes) < 100
    assert len(probes) > 1


def test_no_probe_without_a_gap(street):
    """Nobody stands before one."""
    ways = street.ways_from(street.node_at(9.0, 3.0))
    assert street.frontier.probe(ways, NOTHING, street.outside) is None
    assert not street.frontier.close(street.outside)
    assert not street.frontier.still_there(ways, 0, street.outside)


def test_gap_that_measurements_open(street):
    """It is not there any more, and is left."""
    here = street.node_at(9.0, 3.0)
    street.frontier.stand_before_gap(street.ways(), here, street.outside)
    assert street.frontier.still_there(street.ways(), here, street.outside)
    street.outside[:] = False
    assert not street.frontier.still_there(street.ways(), here, street.outside)
    street.frontier.leave()
    assert not street.frontier.probing
    assert (street.frontier.node_factor(street.outside) == 1.0).all()


def test_closing(street):
    """Nodes below the bound about the gap cost far more from then on, once."""
    here = street.node_at(9.0, 3.0)
    street.frontier.stand_before_gap(street.ways(), here, street.outside)
    assert street.frontier.close(street.outside)
    assert not street.frontier.probing
    factor = street.frontier.node_factor(street.outside)
    closed = factor == CLOSED_FACTOR
    assert closed.any()
    assert street.outside[closed].all()
    # What comes within the bound later is no gap, closed or not.
    assert (street.frontier.node_factor(street.outside & ~closed)[closed] == 1.0).all()


def test_crossing_ends_where_it_comes_out(street):
    """Closed gaps cost as others while crossing, which lasts until the robot is out again."""
    here = street.node_at(9.0, 3.0)
    street.frontier.stand_before_gap(street.ways(), here, street.outside)
    street.frontier.close(street.outside)
    street.frontier.cross()
    assert street.frontier.crossing and not street.frontier.probing
    assert street.frontier.node_factor(street.outside).max() == OUT_OF_BOUND_FACTOR
    for is_outside, is_crossing in ((False, True), (True, True), (True, True), (False, False)):
        street.frontier.follow(is_outside)
        assert street.frontier.crossing == is_crossing
