"""A step of a network by the laws against shapely's diagram, and ten thousand agents that move."""

from __future__ import annotations

import numpy as np
import shapely
from network_cases import step_times
from network_control import drive
from pytest_benchmark.fixture import BenchmarkFixture

from planopt.coverage import ConvexGround, MoveLimits, convex_region


def test_laws(benchmark: BenchmarkFixture) -> None:
    """At most three times the diagram of the same places, in one run (goal of the laws)."""
    law_s, diagram_s = benchmark.pedantic(lambda: step_times(1000, 15, 0), rounds=1)
    assert law_s <= 3.0 * diagram_s


def test_ten_thousand_agents(benchmark: BenchmarkFixture) -> None:
    """Three steps of agents with bodies and a speed limit; the verifier objects to none."""
    side_m = 1000.0
    outline = shapely.box(0.0, 0.0, side_m, side_m)
    grid = np.arange(5.0, side_m, 10.0)
    places = np.stack(np.meshgrid(grid, grid), axis=2).reshape(-1, 2)
    places = places + 3.0 * np.random.default_rng(0).random(places.shape)
    limits = MoveLimits(speed_m_s=3.0, body_radius_m=1.0)
    sums = benchmark.pedantic(
        lambda: drive(ConvexGround(convex_region(outline)), outline, places, limits, 10, 3, None),
        rounds=1,
    )
    assert len(places) == 10_000 and sums["faults"] == 0.0 and sums["path"] > 0.0
