"""Clearance of arcs and parabolas against dense sampling and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from planopt.world.clearance import index_obstacles
from planopt.world.motion import Arc, Parabola, PointCurve
from planopt.world.workspace import Obstacle, Workspace

BOUNDS = (-10.0, -10.0, 10.0, 10.0)


def index_of(*polygons: shapely.Polygon):
    """An index of these polygons."""
    return index_obstacles(
        Workspace(BOUNDS, tuple(Obstacle(str(k), p) for k, p in enumerate(polygons)))
    )


def dense(way: Arc, count: int = 20001) -> np.ndarray:
    """Many places of an arc, by summing up its tangent."""
    half = way.length_m / (count - 1)
    middle = way.heading_rad + way.turn_rad * (np.arange(count - 1) + 0.5) / (count - 1)
    # The chord of a small arc in the direction of its middle.
    chord = half * np.sinc(way.turn_rad / (count - 1) / 2.0 / math.pi)
    steps = chord * np.column_stack([np.cos(middle), np.sin(middle)])
    return way.start_m + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])


def random_polygon(generator: np.random.Generator) -> shapely.Polygon:
    """A star, not convex, somewhere near the middle."""
    angle = np.linspace(0.0, 2.0 * math.pi, 9)[:-1]
    radius = generator.uniform(0.3, 1.5, 8)
    centre = generator.uniform(-3.0, 3.0, 2)
    return shapely.Polygon(
        centre + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    )


@pytest.mark.parametrize("seed", range(40))
def test_arc_clearance_is_that_of_dense_samples(seed: int) -> None:
    """Not above any sample's, and below by no more than the samples are apart."""
    generator = np.random.default_rng(seed)
    index = index_of(*(random_polygon(generator) for _ in range(3)))
    way = Arc(
        generator.uniform(-4.0, 4.0, 2),
        generator.uniform(-7.0, 7.0),
        generator.uniform(-5.0, 5.0),
        generator.uniform(-7.0, 7.0),
    )
    samples = dense(way)
    nearest = min(shapely.MultiPoint(samples).distance(p) for p in index.polygons)
    if any(p.intersects(shapely.LineString(samples)) for p in index.polygons):
        nearest = 0.0
    assert way.clearance_m(index) == pytest.approx(nearest, abs=abs(way.length_m) / 20000)


def test_arc_around_a_disc_has_the_closed_form() -> None:
    """A quarter about a square's corner: the distance of concentric circles."""
    index = index_of(shapely.Polygon([(-2, -2), (0, -2), (0, 0), (-2, 0)]))
    way = Arc(np.array([3.0, 0.0]), math.pi / 2.0, 3.0 * math.pi / 2.0, math.pi / 2.0)
    assert way.clearance_m(index) == pytest.approx(3.0, abs=1e-12)
    # The other way round the chord's side comes nearer: the sagitta.
    edge = index_of(shapely.Polygon([(-5, 4), (5, 4), (5, 5), (-5, 5)]))
    bow = Arc(np.array([-1.0, 0.0]), math.pi / 2.0, math.pi, -math.pi)
    assert bow.clearance_m(edge) == pytest.approx(3.0, abs=1e-12)


def test_arc_inside_and_across() -> None:
    """Zero within an obstacle and across one, though both ends are outside."""
    square = shapely.box(-1.0, -1.0, 1.0, 1.0)
    inside = Arc(np.array([0.0, 0.0]), 0.0, 0.5, 1.0)
    across = Arc(np.array([-2.0, 0.0]), 0.3, 4.1, -0.6)
    ring = index_of(shapely.Polygon(square.exterior, [shapely.box(-0.9, -0.9, 0.9, 0.9).exterior]))
    assert inside.clearance_m(index_of(square)) == 0.0
    assert across.clearance_m(index_of(square)) == 0.0
    # A hole is free.
    assert inside.clearance_m(ring) > 0.3


def test_an_arc_that_hardly_turns_is_a_line() -> None:
    """No jump where the formula changes."""
    index = index_of(shapely.box(-1.0, 1.0, 1.0, 2.0))
    at = [
        Arc(np.array([-2.0, 0.0]), 0.0, 4.0, turn).clearance_m(index)
        for turn in (0.0, 1e-12, 1e-9, 1.9e-9, 2.1e-9, 1e-8)
    ]
    assert at == pytest.approx([1.0] * 6, abs=2e-8)


def test_standing_and_turning_in_place() -> None:
    """A way without length is its place."""
    index = index_of(shapely.box(1.0, -1.0, 2.0, 1.0))
    assert Arc(np.zeros(2), 0.3, 0.0, 2.0).clearance_m(index) == pytest.approx(1.0)
    assert Parabola(np.zeros(2), np.zeros(2), np.zeros(2)).clearance_m(index) == pytest.approx(1.0)
    assert Arc(np.zeros(2), 0.3, 1.0, 2.0).clearance_m(index_of()) == math.inf
    assert Parabola(np.zeros(2), np.ones(2), np.ones(2)).clearance_m(index_of()) == math.inf


@pytest.mark.parametrize("seed", range(20))
def test_parabola_clearance_is_a_tight_bound_below(seed: int) -> None:
    """Below every sample's, and by no more than a micrometre and the samples' spacing."""
    generator = np.random.default_rng(seed)
    index = index_of(*(random_polygon(generator) for _ in range(3)))
    way = Parabola(*generator.uniform(-3.0, 3.0, (3, 2)))
    t = np.linspace(0.0, 1.0, 40001)[:, None]
    samples = way.start_m + t * way.along_m + t * t * way.bend_m
    line = shapely.LineString(samples)
    nearest = min(line.distance(p) for p in index.polygons)
    assert nearest - 2e-6 <= way.clearance_m(index) <= nearest + 1e-9


def test_points_with_a_bound() -> None:
    """The bound is taken off, never below zero."""
    index = index_of(shapely.box(1.0, -1.0, 2.0, 1.0))
    places = np.array([[0.0, 0.0], [0.5, 0.0]])
    assert PointCurve(places, 0.2).clearance_m(index) == pytest.approx(0.3)
    assert PointCurve(places, 0.7).clearance_m(index) == 0.0
