"""Calls of planopt.coverage with wrong arguments: each is one error of the table of messages."""

import math
from functools import partial

import numpy as np
import pytest
import shapely
from refusals import refused

from planopt.coverage import (
    CallableDensity,
    ConvexGround,
    EventSensor,
    Gains,
    GaussianMixture,
    Medium,
    Motion,
    MoveLimits,
    Network,
    RasterDensity,
    checked_mass,
    convex_region,
    coverage,
    demanded,
    elect_leader,
    geodesic_ground,
    ground_sets,
    law_moves,
    locate_event,
    plan_moves,
    propagate_flags,
    single_readings,
    voronoi_cells,
)
from planopt.world import Raster

BOX = shapely.box(0.0, 0.0, 100.0, 100.0)
SQUARE = convex_region(BOX)
CELLS = voronoi_cells(SQUARE, np.array([[10.0, 50.0], [90.0, 40.0]]))
AXIS = np.arange(5.0, 100.0, 10.0)
CHAIN = Network(3, np.array([[0, 1], [1, 2]]))
BLOCK = shapely.box(20, 20, 40, 70)
AGENT = np.array([[10.0, 10.0]])


def raster(value, shift=0.0):
    return RasterDensity(Raster(AXIS + shift, AXIS, np.full((10, 10), value)))


def moves(apart_m=10.0, speed=0.0, **more):
    limits = {"speed_m_s": 1.0, "body_radius_m": 1.0, "acceleration_m_s2": 1.0} | more
    agents = np.array([[10.0, 10.0], [10.0 + apart_m, 10.0]])
    motion = Motion(agents, np.full((2, 2), speed), np.zeros(2))
    return plan_moves(ConvexGround(SQUARE), motion, agents, MoveLimits(**limits), 0.5, 3).motion


REFUSED = {
    "region": [
        partial(convex_region, outline)
        for outline in [
            np.array([[0, 0], [1, 1], [1, 0], [0, 1.0]]),
            np.array([[0, 0], [4, 0], [1, 1], [0, 4.0]]),
            np.array([[0, 0], [1, 1], [2, 2.0]]),
            np.array([[0, 0], [1, np.nan], [2, 2.0]]),
            np.array([[0, 0], [1, 0.0]]),
            np.zeros((4, 3)),
            shapely.Polygon(),
            shapely.box(0, 0, 4, 4).difference(shapely.box(1, 1, 2, 2)),
        ]
    ],
    "ground": [
        partial(geodesic_ground, BOX, [shapely.box(50, -1, 51, 101)], 4.0),
        partial(geodesic_ground, BOX, [shapely.box(-1, -1, 101, 101)], 4.0),
        partial(geodesic_ground, BOX, [shapely.Polygon()], 4.0),
        partial(geodesic_ground, SQUARE.corners_m[[0, 2, 1, 3]], [], 4.0),
        partial(geodesic_ground, BOX, [], 0.01),
        partial(geodesic_ground, BOX, [BLOCK], 4.0, clearance_m=50.0),
        lambda: ground_sets(geodesic_ground(BOX, [BLOCK], 4.0), AGENT, AGENT, AGENT, 0.7, 25.0),
    ],
    "density": [
        partial(coverage, CELLS, CallableDensity(lambda q: q[:, 0] - 50.0, 20.0)),
        partial(coverage, CELLS, CallableDensity(lambda q: np.full(len(q), np.nan), 20.0)),
        partial(coverage, CELLS, CallableDensity(lambda q: q, 20.0)),
        partial(coverage, CELLS, CallableDensity(lambda q: q[:, 0], 1e-3)),
        partial(raster, 0.0),
        partial(raster, -1.0),
        partial(GaussianMixture, np.zeros(1), np.zeros((1, 2)), np.ones(1)),
        lambda: checked_mass(SQUARE, raster(1.0, shift=-500.0)),
        partial(checked_mass, SQUARE, CallableDensity(lambda q: np.zeros(len(q)), 20.0)),
    ],
    "agents": [
        partial(voronoi_cells, SQUARE, np.array([[50.0, 50.0], [101.0, 50.0]])),
        partial(law_moves, AGENT, AGENT + 1.0, np.array([True]), Gains(2.0, 1.0), 0.6),
        partial(moves, apart_m=0.5),
        partial(moves, speed=9.0),
        partial(moves, turn_rate_rad_s=1.0),
        partial(moves, speed_m_s=math.inf),
    ],
    "assignment": [
        *(partial(demanded, bad, 3) for bad in (lambda n: n + 1, lambda n: -1, lambda n: 0.5)),
        partial(propagate_flags, Medium(CHAIN), np.array([1.0, 2.0]), 1),
        partial(propagate_flags, Medium(CHAIN), np.array([1.0, 2.0, 3.0]), -1),
        partial(propagate_flags, Medium(CHAIN, 0.5), np.array([1.0, 2.0, 3.0]), 1),
        partial(elect_leader, Network(3, np.array([[0, 1]])), np.arange(3)),
    ],
    "readings": [
        partial(
            locate_event,
            EventSensor(0.05, 1.0),
            single_readings(np.zeros((0, 2)), np.zeros(0)),
            SQUARE,
        )
    ],
}


@pytest.mark.parametrize("subject", REFUSED)
def test_coverage_refused(subject):
    for call in REFUSED[subject]:
        with refused():
            call()
