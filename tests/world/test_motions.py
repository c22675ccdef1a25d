"""Curves and motions: distances against samples and closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from planopt import Obstacle, Workspace
from planopt.world import (
    CLOSE_M,
    Arc,
    Parabola,
    PointCurve,
    TimedMotion,
    closest_approach_m,
    curve_distance_m,
    even_motion,
    index_obstacles,
    least_gap,
    nearest_to_origin_m,
    step_distances_m,
)

BOUNDS = (-10.0, -10.0, 10.0, 10.0)


def index_of(*polygons: shapely.Polygon):
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


def test_arcs_in_closed_form() -> None:
    """Concentric circles, zero within and across an obstacle, and no jump to a straight line."""
    index = index_of(shapely.Polygon([(-2, -2), (0, -2), (0, 0), (-2, 0)]))
    way = Arc(np.array([3.0, 0.0]), math.pi / 2.0, 3.0 * math.pi / 2.0, math.pi / 2.0)
    assert way.clearance_m(index) == pytest.approx(3.0, abs=1e-12)
    # The other way round the chord's side comes nearer: the sagitta.
    edge = index_of(shapely.Polygon([(-5, 4), (5, 4), (5, 5), (-5, 5)]))
    bow = Arc(np.array([-1.0, 0.0]), math.pi / 2.0, math.pi, -math.pi)
    assert bow.clearance_m(edge) == pytest.approx(3.0, abs=1e-12)
    square = shapely.box(-1.0, -1.0, 1.0, 1.0)
    inside = Arc(np.array([0.0, 0.0]), 0.0, 0.5, 1.0)
    across = Arc(np.array([-2.0, 0.0]), 0.3, 4.1, -0.6)
    ring = index_of(shapely.Polygon(square.exterior, [shapely.box(-0.9, -0.9, 0.9, 0.9).exterior]))
    assert inside.clearance_m(index_of(square)) == 0.0
    assert across.clearance_m(index_of(square)) == 0.0
    # A hole is free.
    assert inside.clearance_m(ring) > 0.3
    index = index_of(shapely.box(-1.0, 1.0, 1.0, 2.0))
    at = [
        Arc(np.array([-2.0, 0.0]), 0.0, 4.0, turn).clearance_m(index)
        for turn in (0.0, 1e-12, 1e-9, 1.9e-9, 2.1e-9, 1e-8)
    ]
    assert at == pytest.approx([1.0] * 6, abs=2e-8)


def test_standing_and_points() -> None:
    """A path without length is its position; the bound of points is taken off, never below zero."""
    index = index_of(shapely.box(1.0, -1.0, 2.0, 1.0))
    assert Arc(np.zeros(2), 0.3, 0.0, 2.0).clearance_m(index) == pytest.approx(1.0)
    assert Parabola(np.zeros(2), np.zeros(2), np.zeros(2)).clearance_m(index) == pytest.approx(1.0)
    assert Arc(np.zeros(2), 0.3, 1.0, 2.0).clearance_m(index_of()) == math.inf
    assert Parabola(np.zeros(2), np.ones(2), np.ones(2)).clearance_m(index_of()) == math.inf
    index = index_of(shapely.box(1.0, -1.0, 2.0, 1.0))
    places = np.array([[0.0, 0.0], [0.5, 0.0]])
    assert PointCurve(places, 0.2).clearance_m(index) == pytest.approx(0.3)
    assert PointCurve(places, 0.7).clearance_m(index) == 0.0


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


DENSE = np.linspace(0.0, 1.0, 40001)


def sampled_m(first, second) -> float:
    return float(np.linalg.norm(first.at(DENSE) - second.at(DENSE), axis=1).min())


def random_way(generator: np.random.Generator, kind: int):
    """A straight path, a parabola, an arc, or points."""
    start = generator.uniform(-4.0, 4.0, 2)
    match kind:
        case 0:
            return even_motion(np.stack([start, generator.uniform(-4.0, 4.0, 2)]))
        case 1:
            return Parabola(start, *generator.uniform(-5.0, 5.0, (2, 2)))
        case 2:
            heading, length, turn = generator.uniform(-6.0, 6.0, 3).tolist()
            return Arc(start, heading, length, turn)
        case _:
            return PointCurve(start + generator.normal(size=(5, 2)).cumsum(axis=0), 0.0)


@pytest.mark.parametrize("seed", range(60))
def test_never_above_dense_samples_and_hardly_below(seed: int) -> None:
    generator = np.random.default_rng(seed)
    first, second = (random_way(generator, kind) for kind in divmod(seed % 16, 4))
    found, sampled = curve_distance_m(first, second), sampled_m(first, second)
    assert found <= sampled + 1e-12
    # Between samples both move by no more than this.
    speed = sum(
        np.linalg.norm(np.diff(way.at(DENSE), axis=0), axis=1).max() for way in (first, second)
    )
    assert found >= sampled - speed - CLOSE_M


def test_two_parabolas_in_closed_form() -> None:
    """Thrown at each other's height: relative motion is (2 t - 1, b t (1 - t) + 1)."""
    for b in (-3.0, -0.5, 0.5, 7.0):
        first = Parabola(np.array([-1.0, 1.0]), np.array([2.0, b]), np.array([0.0, -b]))
        second = Parabola(np.zeros(2), np.zeros(2), np.zeros(2))
        both = np.array([0.7, 3.0])
        moved = [
            replace(way, along_m=way.along_m + both, bend_m=way.bend_m - both)
            for way in (first, second)
        ]
        # With s = (2 t - 1)^2 the square is s + (1 + b (1 - s) / 4)^2: a parabola in s.
        linear, square = 1.0 - 0.5 * b * (1.0 + 0.25 * b), b * b / 16.0
        s = min(max(-linear / (2.0 * square), 0.0), 1.0)
        exact = math.sqrt(s + (1.0 + 0.25 * b * (1.0 - s)) ** 2)
        for one, two in ((first, second), moved):
            assert exact - CLOSE_M <= curve_distance_m(one, two) <= exact + 1e-12


def test_a_convoy_keeps_its_distance() -> None:
    """At equal distance throughout: no part can be skipped, and the distance is still found."""
    way = Arc(np.zeros(2), 0.3, 4.0, 1.0)
    other = replace(way, start_m=np.array([0.6, -0.8]))
    assert curve_distance_m(way, other) == pytest.approx(1.0, abs=1.1 * CLOSE_M)
    assert curve_distance_m(way, way) == 0.0


def test_bounds_of_what_is_not_known() -> None:
    """They are subtracted, no distance is negative, and endless curves claim nothing."""
    one = PointCurve(np.array([[0.0, 0.0], [1.0, 0.0]]), 0.25)
    two = PointCurve(np.array([[0.0, 2.0], [0.5, 2.0], [1.0, 2.0]]), 0.5)
    assert curve_distance_m(one, two) == pytest.approx(1.25)
    assert curve_distance_m(one, replace(two, within_m=5.0)) == 0.0
    assert curve_distance_m(one, replace(two, within_m=math.inf)) == 0.0
    far = Parabola(np.zeros(2), np.full(2, 1e12), np.full(2, 1e12))
    endless = Parabola(np.zeros(2), np.zeros(2), np.full(2, np.inf))
    still = even_motion(np.array([[5.0, 0.0], [5.0, 0.0]]))
    assert curve_distance_m(endless, still) == 0.0
    assert curve_distance_m(far, still) <= 5.0


@pytest.mark.parametrize("seed", range(12))
def test_the_least_step_is_found(seed: int) -> None:
    """As if all were looked at, also where one stands before the other."""
    generator = np.random.default_rng(seed)

    def motion(steps: int) -> TimedMotion:
        ways, place = [], generator.uniform(-3.0, 3.0, 2)
        for _ in range(steps):
            ways.append(Parabola(place, *generator.uniform(-2.0, 2.0, (2, 2))))
            place = ways[-1].at(np.array([1.0]))[0]
        return TimedMotion(np.array([*(way.start_m for way in ways), place]), tuple(ways))

    one, two = motion(5), motion(3)
    taken = generator.uniform(0.0, 1.0, 6)
    gaps = step_distances_m(one, two, 6) - taken
    least, step = least_gap(one, two, taken)
    assert least == pytest.approx(gaps.min(), abs=2.0 * CLOSE_M)
    assert gaps[step] == pytest.approx(gaps.min(), abs=2.0 * CLOSE_M)
    # A step later, with a step of standing before, nothing is nearer or farther.
    later = [
        TimedMotion(
            np.vstack([each.places_m[:1], each.places_m]),
            (even_motion(each.places_m[:1].repeat(2, axis=0)), *each.curves),
        )
        for each in (one, two)
    ]
    shifted, at = least_gap(*later, np.append(5.0 - 5.0, taken))
    first = np.linalg.norm(one.places_m[0] - two.places_m[0])
    assert shifted == pytest.approx(min(least, first), abs=2.0 * CLOSE_M)
    assert at in (0, step + 1)


def test_what_is_left_after_some_steps() -> None:
    way = Parabola(np.zeros(2), np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    two = Parabola(np.ones(2), np.array([1.0, 2.0]), np.array([0.0, -1.0]))
    motion = TimedMotion(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]), (way, two))
    rest = motion.after(1).lasting(3)
    assert rest.places_m.tolist() == [[1.0, 1.0], [2.0, 2.0], [2.0, 2.0], [2.0, 2.0]]
    assert rest.curve(0) is two
    assert motion.bulges_m == pytest.approx([0.25, 0.25])
    assert rest.bulges_m == pytest.approx([0.25, 0.0, 0.0])


SHARES = np.linspace(0.0, 1.0, 20_001)[:, None]
PLACE = st.tuples(*[st.floats(-1e3, 1e3, width=32)] * 2).map(np.array)


@given(PLACE, PLACE, PLACE, PLACE)
def test_never_above_any_sample_and_met_by_one(a0, a1, b0, b1):
    """Between samples the distance changes by no more than the relative motion does."""
    found = float(closest_approach_m(a0, a1, b0, b1))
    apart = (1.0 - SHARES) * (a0 - b0) + SHARES * (a1 - b1)
    sampled = float(np.hypot(*apart.T).min())
    between = float(np.hypot(*((a1 - b1) - (a0 - b0)))) / 20_000
    assert found <= sampled + 1e-9
    assert found >= sampled - between - 1e-9


def test_equal_times_are_what_counts():
    """Paths that cross do not meet where one passes later; ends come out to the last digit."""
    cross = closest_approach_m(*map(np.array, ([0.0, 0], [10.0, 0], [5.0, -5], [5.0, 5])))
    assert cross == pytest.approx(0.0, abs=1e-12)
    later = closest_approach_m(*map(np.array, ([0.0, 0], [10.0, 0], [9.0, -9], [9.0, 1])))
    assert later == pytest.approx(0.0, abs=1e-9)
    chase = closest_approach_m(*map(np.array, ([0.0, 0], [4.0, 0], [-3.0, 0], [1.0, 0])))
    assert chase == 3.0
    swap = closest_approach_m(*map(np.array, ([0.0, 0], [4.0, 0], [4.0, 0], [0.0, 0])))
    assert swap == pytest.approx(0.0, abs=1e-12)
    begin, end = np.array([0.1, 0.7]), np.array([7.3, 11.9])
    assert (nearest_to_origin_m(begin, end) == begin).all()
    assert (nearest_to_origin_m(end, begin) == begin).all()
    assert (nearest_to_origin_m(begin, begin) == begin).all()
    bad = np.array([np.nan, 0.0])
    assert np.isnan(closest_approach_m(bad, end, begin, begin))
