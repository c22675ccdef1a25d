"""Receding-horizon moves: the law where nothing binds, the reference programme, and limits kept."""

import math
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from planopt.coverage import (
    UNBOUNDED,
    ConvexGround,
    ConvexRegion,
    Gains,
    GeodesicGround,
    Inertia,
    Motion,
    MoveLimits,
    Programmes,
    SafeSets,
    geodesic_ground,
    ground_sets,
    law_moves,
    plan_moves,
    solve_programme,
    solve_programmes,
    verify_moves,
)
from tests.coverage.scattered import scattered, swept

Floats = NDArray[np.float64]
KINDS = {"single": {}, "double": {"acceleration_m_s2": 1.5}, "unicycle": {"turn_rate_rad_s": 1.0}}


@pytest.fixture
def blocks() -> GeodesicGround:
    """A region that is not convex, with two obstacles."""
    outline = shapely.Polygon([(0, 0), (60, 0), (60, 40), (35, 40), (35, 30), (0, 30)])
    walls = [shapely.box(15, 5, 20, 24), shapely.Polygon([(35, 5), (50, 12), (40, 22)])]
    return geodesic_ground(outline, walls, 2.0, clearance_m=0.6)


@pytest.mark.parametrize("horizon", [1, 2, 5, 20])
@pytest.mark.parametrize("gain", [0.05, 0.7, 2.0])
def test_first_move_is_the_laws(square: ConvexRegion, horizon: int, gain: float) -> None:
    """Without a binding limit the first move is that of the law, by closed form and programme."""
    agents = scattered(square, 40, np.random.default_rng(3))
    targets = scattered(square, 40, np.random.default_rng(4))
    motion, limits = Motion.at_rest(agents), MoveLimits(time_step_s=0.5)
    after = plan_moves(ConvexGround(square), motion, targets, limits, gain, horizon).motion
    law = law_moves(agents, targets, np.zeros(40, bool), Gains(1.0, gain), 0.5)
    np.testing.assert_allclose(after.places_m, law, atol=1e-8)
    free = UNBOUNDED
    share = np.full(40, 0.5 * gain)
    found = solve_programme(agents, targets, share, horizon, 1e3, free)
    assert found is not None
    np.testing.assert_allclose(found[0][:, 1], law, atol=1e-5)


@pytest.mark.parametrize("inert", [False, True])
@pytest.mark.parametrize("share", [0.3, 1.0])
def test_programme_agrees_with_reference(share: float, inert: bool) -> None:
    """Clarabel's programme has the optimum that CVXPY finds, with half-planes and discs active."""
    rng = np.random.default_rng(8)
    count, horizon, most, change, stop = 6, 7, 1.3, 0.5, 3
    starts, aims = rng.random((count, 2)) * 4.0, rng.random((count, 2)) * 20.0 - 8.0
    now = 0.3 * rng.normal(size=(count, 2)) if inert else np.zeros((count, 2))
    agent = np.repeat(np.arange(count), 4)
    turn = rng.random((count, 1)) * 6.0 + np.arange(4) * np.pi / 2
    normals = np.stack((np.cos(turn), np.sin(turn)), axis=2).reshape(-1, 2)
    rooms = 1.2 + 3.0 * rng.random(len(agent))
    offsets = (normals * starts[agent]).sum(axis=1) + rooms
    sets = SafeSets(agent, normals, offsets, np.arange(count), starts + 1.0, np.full(count, 3.5))
    inertia = Inertia(now, change, np.full(count, stop)) if inert else None
    found = solve_programme(starts, aims, np.full(count, share), horizon, most, sets, inertia)
    assert found is not None
    for which in range(count):
        p, w = cp.Variable((horizon + 1, 2)), cp.Variable((horizon + 1, 2))
        cost = sum(cp.sum_squares(p[j] - aims[which]) for j in range(1, horizon))
        cost += (1.0 - share) / share**2 * cp.sum_squares(cp.diff(p, axis=0))
        limits = [p[0] == starts[which], w[0] == now[which]]
        kept, last = p[1:], cp.sum_squares(p[horizon] - aims[which])
        if inert:
            kept = p[1:] + 0.5 * stop * w[1:]
            last = 0.5 * (last + cp.sum_squares(kept[horizon - 1] - aims[which]))
            cost += 0.25 / share**2 * cp.sum_squares(cp.diff(w, axis=0))
            limits += [cp.diff(p, axis=0) == 0.5 * (w[1:] + w[:-1])]
            limits += [cp.norm(cp.diff(w, axis=0), axis=1) <= change]
            limits += [cp.norm(w[1:], axis=1) <= most]
        else:
            limits += [cp.norm(cp.diff(p, axis=0), axis=1) <= most]
        one = sets.of(np.array([which]))
        for normal, offset in zip(one.normals, one.offsets_m, strict=True):
            limits.append(kept @ normal <= offset)
        limits.append(cp.norm(kept - one.centres_m, axis=1) <= one.radii_m[0])
        cp.Problem(cp.Minimize(cost + last / share), limits).solve(solver=cp.CLARABEL)
        np.testing.assert_allclose(found[0][which], p.value, atol=3e-4)
        if inert:
            np.testing.assert_allclose(found[1][which], w.value, atol=3e-4)


def test_added_constraints_reach_the_constrained_optimum() -> None:
    """Constraints that are added when violated lead to the optimum of CVXPY under all of them."""
    rng = np.random.default_rng(11)
    count, steps, ways = 60, 5, 7
    root = rng.normal(size=(count, steps, steps))
    turn = 2.0 * np.pi * rng.random((count, 4))
    given = Programmes(
        root @ root.transpose(0, 2, 1) + 0.1 * np.eye(steps),
        3.0 * rng.normal(size=(count, steps, 2)),
        rng.normal(size=(count, steps, steps)),
        0.1 * rng.normal(size=(count, steps, 2)),
        np.stack((np.cos(turn), np.sin(turn)), axis=2),
        0.3 + rng.random((count, 4)),
        0.1 * rng.normal(size=(count, 2, 2)),
        1.0 + rng.random((count, 2)),
        rng.normal(size=(ways, steps)),
        np.zeros((count, ways, 2)),
        0.5 + rng.random((count, ways)),
    )
    found = solve_programmes(given)
    assert found is not None
    lengths = np.linalg.norm(given.move_map @ found, axis=2)
    assert (lengths <= given.longest + 1e-6).all()
    assert (lengths > given.longest - 1e-5).any(axis=1).sum() > 20
    for which in (0, 7, 31, 59):
        z = cp.Variable((steps, 2))
        places = given.place_map[which] @ z + given.place_offset[which]
        limits = [cp.norm(given.move_map @ z, axis=1) <= given.longest[which]]
        for normal, room in zip(given.normals[which], given.rooms[which], strict=True):
            limits.append(places @ normal <= room)
        for centre, radius in zip(given.centres[which], given.radii[which], strict=True):
            limits.append(cp.norm(places - centre[None], axis=1) <= radius)
        root_of = np.linalg.cholesky(given.hessian[which]).T
        cost = 0.5 * cp.sum_squares(root_of @ z) + cp.sum(cp.multiply(given.linear[which], z))
        cp.Problem(cp.Minimize(cost), limits).solve(solver=cp.CLARABEL)
        np.testing.assert_allclose(found[which], z.value, atol=1e-4)
    rooms = given.rooms.copy()
    rooms[3] = -99.0
    assert solve_programmes(replace(given, rooms=rooms)) is None


@pytest.mark.parametrize("horizon", [1, 4, 12])
def test_drifting_targets_are_led(square: ConvexRegion, horizon: int) -> None:
    """Without a binding limit the first move is the law's in the frame of the target."""
    rng = np.random.default_rng(6)
    agents = scattered(square, 20, rng)
    aims, drifts = agents + 6.0 * rng.normal(size=(20, 2)), rng.normal(size=(20, 2))
    limits = MoveLimits(time_step_s=0.5, speed_m_s=1e3)
    motion, ground = Motion.at_rest(agents), ConvexGround(square)
    after = plan_moves(ground, motion, aims, limits, 0.8, horizon, drifts_m_s=drifts).motion
    law = agents + 0.4 * (aims - agents) + 0.5 * drifts
    inside = np.asarray(square.contains(law) & square.contains(aims + 0.5 * horizon * drifts))
    assert inside.sum() > 10
    np.testing.assert_allclose(after.places_m[inside], law[inside], atol=1e-6)
    # Along a straight line at its greatest speed, a double integrator keeps up with the target.
    here, speed = np.array([[20.0, 50.0]]), np.array([[2.0, 0.0]])
    inert = MoveLimits(speed_m_s=2.0, acceleration_m_s2=0.5)
    motion = Motion(here, speed, np.zeros(1))
    after = plan_moves(ground, motion, here, inert, 0.5, horizon, drifts_m_s=speed).motion
    np.testing.assert_allclose(after.places_m, [[22.0, 50.0]], atol=1e-4)


def test_free_path_needs_no_programme() -> None:
    """The clipped law, repeated, is the optimum of the programme of agents with a free path."""
    rng = np.random.default_rng(2)
    starts, aims = rng.random((8, 2)) * 10.0, rng.random((8, 2)) * 10.0
    free = UNBOUNDED
    for share in (0.1, 0.5, 1.0):
        found = solve_programme(starts, aims, np.full(8, share), 6, 0.8, free)
        assert found is not None
        here = starts
        for step in range(1, 7):
            here = law_moves(here, aims, np.zeros(8, bool), Gains(1.0, share), 1.0, 0.8)
            np.testing.assert_allclose(here, found[0][:, step], atol=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_bodies_never_touch(square: ConvexRegion, kind: str) -> None:
    """Agents that all want the same position, then opposite ones, stay apart all along."""
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.arange(8.0, 95.0, 16.0), np.arange(8.0, 95.0, 16.0)), axis=2)
    motion = Motion.at_rest(grid.reshape(-1, 2)[:24] + rng.random((24, 2)))
    limits = MoveLimits(speed_m_s=4.0, body_radius_m=1.0, time_step_s=0.5, **KINDS[kind])
    least, opposite = math.inf, 100.0 - motion.places_m
    for step in range(45):
        targets = np.full_like(opposite, 50.0) if step < 32 else opposite
        after = plan_moves(ConvexGround(square), motion, targets, limits, 1.0, 8).motion
        places = swept(motion, after, limits)
        apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=3)
        least, motion = min(least, float((apart + 99.0 * np.eye(24)).min())), after
        assert (square.excess_m(after.places_m) <= -1.0 + 1e-9).all()
        assert (np.linalg.norm(after.velocities_m_s, axis=1) <= 4.0 + 1e-9).all()
        if step == 31:
            near = np.sort(np.linalg.norm(after.places_m - 50.0, axis=1))
            assert near[6] < 4.0
    assert 2.0 < least < 2.1


@pytest.mark.parametrize("kind", KINDS)
def test_agents_pass_obstacles(blocks: GeodesicGround, kind: str) -> None:
    """Agents get round obstacles to targets behind them, and never nearer to them than allowed."""
    motion = Motion.at_rest(np.array([[2.0, 2.0], [10.0, 27.0], [55.0, 2.0], [26.0, 15.0]]))
    limits = MoveLimits(speed_m_s=2.0, body_radius_m=0.5, clearance_m=0.6, **KINDS[kind])
    aims = np.array([[45.0, 37.0], [57.0, 20.0], [5.0, 20.0], [46.0, 7.0]])
    border = shapely.boundary(blocks.free)
    for _ in range(120):
        targets = blocks.steered(motion.places_m, aims, 0.5)
        after = plan_moves(blocks, motion, targets, limits, 0.5, 8).motion
        places = shapely.points(swept(motion, after, limits))
        assert shapely.distance(border, places).min() > 0.6 - 1e-6
        motion = after
    assert np.linalg.norm(motion.places_m - aims, axis=1).max() < 0.1


def test_round_clearance_of_a_corner_is_kept() -> None:
    """An agent between the mitred and the round clearance of a corner does not cut the corner."""
    square, wall = shapely.box(0, 0, 30, 30), shapely.box(12, 10, 20, 20)
    ground = geodesic_ground(square, [wall], 2.0, clearance_m=1.0)
    motion = Motion.at_rest(np.array([[11.2, 9.36]]))
    assert 1.0 < float(wall.distance(shapely.Point(11.2, 9.36))) < 1.03
    limits = MoveLimits(speed_m_s=2.0, body_radius_m=0.8, clearance_m=1.0)
    after = plan_moves(ground, motion, np.array([[10.0, 28.0]]), limits, 0.5, 6).motion
    assert not verify_moves(ground.free, motion, after, limits)


def test_corridors_hold_no_border(blocks: GeodesicGround) -> None:
    """Positions of a corridor keep the clearance, and the free straight path is within it."""
    rng = np.random.default_rng(6)
    drawn = rng.random((400, 2)) * [60.0, 40.0]
    agents = drawn[blocks.allows(drawn)][:60]
    agents[:4] = [[14.4, 24.6], [20.6, 10.0], [14.4, 10.0], [0.6, 0.6]]
    aims = rng.random((len(agents), 2)) * [60.0, 40.0]
    aims[:3] = [[20.6, 24.6], [20.6, 24.6], [14.4, 24.6]]
    sets = ground_sets(blocks, agents, agents, aims, 0.6, 25.0)
    for which, (agent, aim) in enumerate(zip(agents, aims, strict=True)):
        near = agent + 30.0 * (rng.random((300, 2)) - 0.5)
        near = near[np.linalg.norm(near - agent, axis=1) < 12.0]
        one = sets.of(np.array([which]))
        inside = (near @ one.normals.T <= one.offsets_m).all(axis=1)
        assert inside.any() and (one.normals @ agent <= one.offsets_m + 1e-9).all()
        assert shapely.contains(blocks.free, shapely.points(near[inside])).all()
        away = shapely.distance(shapely.boundary(blocks.free), shapely.points(near[inside]))
        assert away.min() >= 0.6 - 1e-6
        if blocks.area.sees(agent[None], aim[None])[0]:
            length = float(np.linalg.norm(aim - agent))
            reached = agent + (aim - agent) * min(1.0, 25.0 / length)
            assert (one.normals @ reached <= one.offsets_m + 1e-9).all()


def test_points_may_meet(square: ConvexRegion) -> None:
    """Agents without bodies all get to one place, also from one place."""
    motion = Motion.at_rest(np.array([[10.0, 10.0], [10.0, 10.0], [80.0, 30.0]]))
    middle, limits = np.full((3, 2), 50.0), MoveLimits(speed_m_s=3.0)
    for _ in range(60):
        motion = plan_moves(ConvexGround(square), motion, middle, limits, 0.5, 4).motion
    np.testing.assert_allclose(motion.places_m, 50.0, atol=1e-6)


def test_double_integrators_can_always_stop(square: ConvexRegion) -> None:
    """A fast crowd whose targets jump keeps its acceleration, and stops clear of each other."""
    rng = np.random.default_rng(11)
    agents = np.stack(np.meshgrid(np.arange(30, 70, 8.0), np.arange(30, 70, 8.0)), axis=2)
    motion = Motion.at_rest(agents.reshape(-1, 2))
    limits = MoveLimits(speed_m_s=6.0, acceleration_m_s2=1.0, body_radius_m=1.0)
    for _ in range(25):
        before = motion
        targets = scattered(square, 25, rng)
        motion = plan_moves(ConvexGround(square), before, targets, limits, 0.8, 6).motion
        speeds, agents = motion.velocities_m_s, motion.places_m
        assert np.linalg.norm(speeds - before.velocities_m_s, axis=1).max() <= 1.0 + 1e-6
        mean = 0.5 * (before.velocities_m_s + speeds)
        np.testing.assert_allclose(agents - before.places_m, mean, atol=1e-6)
        stops = agents + speeds * (0.5 * np.ceil(np.linalg.norm(speeds, axis=1)))[:, None]
        lines = shapely.linestrings(np.stack((agents, stops), axis=1))
        apart = shapely.distance(lines[:, None], lines) + 99.0 * np.eye(len(agents))
        assert apart.min() > 2.0
        assert (square.excess_m(stops) <= -1.0 + 1e-6).all()
