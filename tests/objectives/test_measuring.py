"""The measuring rule: what it takes, and the smooth gates that solvers climb in its place."""

import numpy as np
import pytest
from path_scene import CHANNEL, drawn, partly_open

from planopt.channel import condition
from planopt.channel.measurements import SAME_PLACE_M
from planopt.objectives.measuring import (
    CLOSED_SPACINGS,
    OPEN_SPACINGS,
    SPACING_TOLERANCE_M,
    MeasuringRule,
)

SPACING_M = 2.0
POSTERIOR = condition(CHANNEL, drawn(30, side_m=20.0))


def rule_of(*known, spacing_m=SPACING_M):
    """A rule with these places known of each station."""
    return MeasuringRule(spacing_m, tuple(np.reshape(places, (-1, 2)) for places in known))


def taken_in_turn(known, way, spacing_m=SPACING_M):
    """The loop, written out: measure where no earlier measurement is nearer than the spacing."""
    measured, taken = [np.asarray(p) for p in known], []
    for place in way:
        far = all(np.linalg.norm(place - other) >= spacing_m for other in measured)
        if far:
            measured.append(place)
        taken.append(far)
    return taken


@pytest.mark.parametrize("seed", range(20))
def test_takes_what_a_loop_takes(seed):
    """Paths among measurements that return to their own positions, each path by itself."""
    rng = np.random.default_rng(seed)
    known = rng.uniform(0.0, 12.0, (rng.integers(0, 8), 2))
    ways = rng.uniform(0.0, 12.0, (5, 9, 2))
    ways[0, 4:] = ways[0, 3]
    wanted = [taken_in_turn(known, way) for way in ways]
    rule = rule_of(known)
    np.testing.assert_array_equal(rule.takes(ways), wanted)
    np.testing.assert_array_equal(rule.takes(ways[2]), wanted[2])
    np.testing.assert_array_equal(rule.near(ways).takes(ways), wanted)


def test_many_measurements_are_looked_up_alike():
    """The rule near the places alone takes the same ones."""
    rng = np.random.default_rng(3)
    known = rng.uniform(0.0, 60.0, (400, 2))
    places = rng.uniform(0.0, 60.0, (200, 2))
    wanted = np.linalg.norm(places[:, None] - known, axis=2).min(axis=1) >= SPACING_M
    assert 0 < wanted.sum() < len(wanted)
    np.testing.assert_array_equal(rule_of(known).is_open(places), wanted)
    few = [rule_of(known).is_open(places[k : k + 1])[0] for k in range(len(places))]
    np.testing.assert_array_equal(few, wanted)


def test_a_place_is_measured_until_all_stations_were():
    """Known of one station alone it brings a measurement; known of both it does not."""
    near, far = np.array([[0.0, 0.0]]), np.array([[50.0, 0.0]])
    place = np.array([[0.5, 0.0]])
    assert rule_of(near, far).is_open(place)[0]
    assert not rule_of(near, near + 0.2).is_open(place)[0]
    assert rule_of(near, np.zeros((0, 2))).is_open(place)[0]
    ways = np.array([[[0.5, 0.0]]])
    assert rule_of(near, far).gates(ways) is None
    assert rule_of(near, near + 0.2).gates(ways).value[0, 0] == 0.0


def test_without_spacing_a_place_is_still_measured_once():
    """Standing still tells nothing new, whatever the spacing."""
    rule = MeasuringRule.of([POSTERIOR], 0.0)
    assert rule.spacing_m == SAME_PLACE_M
    assert MeasuringRule.of([POSTERIOR], 2.0).spacing_m == 2.0 - SPACING_TOLERANCE_M
    here = POSTERIOR.measurements.positions_m[:1]
    assert not rule.is_open(here)[0]
    assert rule.is_open(here + 1e-3)[0]
    np.testing.assert_array_equal(rule.takes(np.tile(here + 1e-3, (3, 1))), [True, False, False])


@pytest.mark.parametrize("seed", range(20))
def test_gates_are_closed_and_open_where_the_rule_is(seed):
    """Between 0 and 1; but for a narrow ramp about the spacing 0 or 1, as the rule says."""
    rng = np.random.default_rng(seed)
    known, ways = rng.uniform(0.0, 9.0, (5, 2)), rng.uniform(0.0, 9.0, (30, 6, 2))
    rule = rule_of(known)
    gates = rule.gates(ways)
    assert gates is not None
    taken = rule.takes(ways)
    assert ((gates.value >= 0.0) & (gates.value <= 1.0)).all()
    places = ways.reshape(-1, 2)
    # Of first places, which no earlier one of the way is near to.
    for spacings, value in ((CLOSED_SPACINGS, 0.0), (OPEN_SPACINGS, 1.0)):
        far = rule_of(known, spacing_m=spacings * SPACING_M).is_open(places)
        sure = (far if value else ~far).reshape(taken.shape)[:, 0]
        assert (gates.value[:, 0][sure] == value).all()
        assert (taken[:, 0][sure] == bool(value)).all()
    partly = (gates.value > 0.0) & (gates.value < 1.0)
    assert 0 < partly.sum() < 0.2 * partly.size
    np.testing.assert_array_equal(gates.value[~partly], taken[~partly])


def test_gates_are_none_where_all_is_open():
    """Nothing near: solvers work as without a rule."""
    assert rule_of([100.0, 100.0]).gates(np.array([[[0.0, 0.0], [5.0, 0.0]]])) is None


@pytest.mark.parametrize("seed", range(10))
def test_derivatives_of_gates_are_those_of_differences(seed):
    """Jacobian and curvature, between known places and places of the path."""
    rule, way, gates = partly_open(seed)
    weight, h = np.random.default_rng(seed).normal(size=5), 1e-6
    jacobian, curvature = np.empty((5, 10)), np.empty((10, 10))
    for p in range(10):
        step = h * np.eye(10)[p].reshape(1, 5, 2)
        more, less = rule.gates(way[None] + step), rule.gates(way[None] - step)
        jacobian[:, p] = (more.value[0] - less.value[0]) / (2 * h)
        curvature[:, p] = weight @ (more.jacobian()[0] - less.jacobian()[0]) / (2 * h)
    np.testing.assert_allclose(gates.jacobian()[0], jacobian, atol=1e-7)
    np.testing.assert_allclose(gates.curvature(weight), curvature, atol=1e-5)
