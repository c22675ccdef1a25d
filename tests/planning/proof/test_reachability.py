"""The best place that could be reached: against brute force and exact geometry."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from scenes import RING, small_problem

from planopt.planning.proof.searches import best_margins_by_step
from planopt.world.clearance import index_obstacles

START = np.array([5.0, 15.0])
BOUNDS = (0.0, 0.0, 40.0, 30.0)


def index_of(*polygons):
    """The index of these obstacles."""
    return index_obstacles(small_problem(*polygons).workspace)


def best_margin_within_reach(index, margin, start, radius, clearance, bounds=(-60, -60, 100, 90)):
    """The best margin by the first step of this length."""
    return best_margins_by_step(index, bounds, margin, start, radius, np.array([1]), clearance)[0]


def nearness_to(place):
    """A margin that falls with the distance from a place."""
    return lambda q: -np.linalg.norm(q - np.asarray(place), axis=1)


@pytest.mark.parametrize("radius", [1.0, 4.0, 12.0])
@pytest.mark.parametrize("peak", [(5.0, 15.0), (6.1, 15.7), (9.0, 12.0), (30.0, 2.0)])
def test_best_place_of_a_free_disc(radius, peak):
    """The peak itself if it is within reach, else the nearest place to it on the disc's rim."""
    best = best_margin_within_reach(index_of(), nearness_to(peak), START, radius, 0.5)
    away = np.linalg.norm(START - peak)
    exact = -max(away - radius, 0.0)
    assert best <= exact + 1e-9
    assert best >= exact - radius / 12


def test_best_place_against_a_dense_grid():
    """A rough margin with many peaks: not worse than a grid six times as fine but for a little."""
    rng = np.random.default_rng(3)
    waves, phases = rng.normal(0.0, 0.6, (8, 2)), rng.uniform(0.0, 6.0, 8)

    def margin(q):
        return np.sin(q @ waves.T + phases).sum(1) - 10.0

    x, y = np.meshgrid(np.linspace(-6, 6, 301), np.linspace(-6, 6, 301))
    places = START + np.stack([x, y], -1).reshape(-1, 2)
    places = places[np.linalg.norm(places - START, axis=1) <= 6.0]
    best = best_margin_within_reach(index_of(), margin, START, 6.0, 0.5)
    assert best == pytest.approx(margin(places).max(), abs=0.05)


def test_best_place_is_not_behind_walls():
    """From within a courtyard with walls four metres thick nothing outside is in reach."""
    inside = np.array([15.0, 15.0])
    outside = nearness_to((9.0, 15.0))
    best = best_margin_within_reach(index_of(RING), outside, inside, 7.0, 0.6)
    assert best == pytest.approx(-(14.0 + 0.0 - 9.0), abs=1.0)
    assert best < -4.0
    free = best_margin_within_reach(index_of(), outside, inside, 7.0, 0.6)
    assert free == pytest.approx(0.0, abs=0.3)


def test_more_steps_are_never_worse():
    """A small good place near the start stays found however many steps are asked about."""
    peak = nearness_to((11.0, 17.0))
    steps = np.arange(1, 301)
    bests = best_margins_by_step(
        index_of(), BOUNDS, lambda q: peak(q) + 3.0, START, 2.0, steps, 0.5
    )
    assert (np.diff(bests) >= 0.0).all()
    assert bests[0] < 0.0 < bests[3]
    assert bests[-1] == pytest.approx(3.0, abs=0.5)


def spot(x, y, radius):
    """A margin of 1 dB in a disc, -1 dB about it."""
    return lambda q: np.where(np.hypot(q[:, 0] - x, q[:, 1] - y) <= radius, 1.0, -1.0)


def first_possible(index, margin, start, clearance, step_m=2.0, steps=30):
    """The first step by which the bound could be met; None if none."""
    best = best_margins_by_step(
        index, BOUNDS, margin, start, step_m, np.arange(1, steps + 1), clearance
    )
    return next((step for step, value in enumerate(best, start=1) if value >= 0.0), None)


@pytest.mark.parametrize("clearance", [0.0, 0.1, 0.5])
def test_walls_thinner_than_the_grid_are_walls(clearance):
    """From a courtyard with walls of 2 cm nothing outside is in reach, however long it takes."""
    outer = shapely.box(10, 10, 20, 20)
    yard = index_of(outer.difference(shapely.box(10.02, 10.02, 19.98, 19.98)))
    inside, outside = np.array([15.0, 15.0]), spot(22.0, 15.0, 1.0)
    assert first_possible(yard, outside, inside, clearance) is None
    assert first_possible(index_of(), outside, inside, clearance) == 3


@pytest.mark.parametrize("clearance", [0.0, 0.5])
def test_ways_lead_round_walls(clearance):
    """Three metres by air, twenty round the end of the wall: ten steps of two metres, not two."""
    wall = index_of(shapely.box(19.9, -1.0, 20.1, 25.0))
    start, margin = np.array([18.0, 15.0]), spot(22.0, 15.0, 1.0)
    # To the corner and from there to the rim of the disc.
    exact = np.hypot(1.9, 10.0) + 0.2 + np.hypot(1.9, 10.0) - 1.0
    assert first_possible(index_of(), margin, start, clearance) == 2
    found = first_possible(wall, margin, start, clearance)
    assert found is not None
    # No sooner than that, and with a clearance at most a step later.
    assert np.ceil(exact / 2.0) <= found <= np.ceil((exact + 2.0 * clearance + 0.5) / 2.0)


def test_good_places_in_lanes_between_the_nodes():
    """A good lane as narrow as a fifth of the grid's spacing is found between its nodes."""
    lane = index_of(shapely.box(5.6, 15.57, 30, 29), shapely.box(5.6, 1, 30, 15.43))
    found = first_possible(lane, spot(9.0, 15.5, 1.0), START, 0.02)
    assert found is not None
    assert 2 <= found <= 3
