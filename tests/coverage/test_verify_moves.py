"""The verifier of moves, and links kept by laws and by learnt maps."""

import math

import numpy as np
import pytest
import shapely

from planopt.channel import ChannelParameters, Station, condition, measure, model_truth
from planopt.coverage import (
    UNBOUNDED,
    ConvexGround,
    ConvexRegion,
    Fault,
    LinkLaw,
    Motion,
    MoveLimits,
    RadioLimits,
    StationMap,
    braking_offsets_m,
    geodesic_ground,
    line_distances_m,
    plan_moves,
    radio_tree,
    station_map,
    verify_moves,
)

HALL = shapely.box(0, 0, 60, 40) - shapely.box(20, 10, 30, 25)
KNOWN = LinkLaw(np.array([-10.0, 2.5]), 6.0, np.zeros((2, 2)))
RADIO = RadioLimits(np.array([[0.0, 0.0]]), KNOWN, KNOWN, -62.0, 0.9)


def kinds(faults: tuple[Fault, ...]) -> set[str]:
    return {fault.kind for fault in faults}


def places(*pairs: tuple[float, float]) -> Motion:
    return Motion.at_rest(np.array(pairs, dtype=float))


def test_contact_between_the_ends_is_found() -> None:
    """Agents that swap places collide; agents that pass each other in time do not."""
    limits = MoveLimits(body_radius_m=0.5, time_step_s=2.0)
    one, other = places((5, 5), (9, 5)), places((9, 5), (5, 5))
    (fault,) = verify_moves(HALL, one, other, limits)
    assert (fault.kind, fault.agent, fault.other, fault.value) == ("contact", 0, 1, 0.0)
    # The second one crosses the first one's way where that has long been.
    crossing = places((5, 5), (10, 1)), places((15, 5), (10, 9))
    assert kinds(verify_moves(HALL, *crossing, limits)) == {"contact"}
    behind = places((5, 5), (7, 1)), places((15, 5), (7, 5.4))
    assert verify_moves(HALL, *behind, limits) == ()
    points = MoveLimits(time_step_s=2.0)
    assert verify_moves(HALL, one, other, points) == ()


def test_parabolas_are_verified_as_driven() -> None:
    """A double integrator that swings near another between the ends touches it."""
    limits = MoveLimits(speed_m_s=9.0, acceleration_m_s2=20.0, body_radius_m=0.5)
    here, still = np.array([[5.0, 5.0], [5.0, 6.5]]), np.zeros(2)
    for speed, touches in ((4.0, True), (1.9, False)):
        up = np.array([[0.0, speed], [0.0, 0.0]])
        found = verify_moves(HALL, Motion(here, up, still), Motion(here, -up, still), limits)
        assert kinds(found) == ({"contact"} if touches else set())
        assert not touches or found[0].value == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("after", "found"),
    [
        ((19.4, 15.0), set()),
        ((19.6, 15.0), {"clearance"}),
        ((35.0, 15.0), {"clearance", "speed"}),
        ((0.3, 15.0), {"clearance", "speed"}),
        ((18.0, 30.9), {"speed"}),
    ],
)
def test_borders_and_speed(after: tuple[float, float], found: set[str]) -> None:
    """Obstacles, the outline and the speed are verified along the path, not at its ends alone."""
    limits = MoveLimits(speed_m_s=4.0, body_radius_m=0.5)
    moved = verify_moves(HALL, places((17, 15)), places(after), limits)
    assert kinds(moved) == found


def test_motion_of_other_kinds() -> None:
    """Accelerations, turn rates and ends that do not fit together are found."""
    inert = MoveLimits(speed_m_s=4.0, acceleration_m_s2=1.0)
    start = places((5, 5))
    for after, velocity, found in (
        ((5.5, 5), (1, 0), set()),
        ((5.7, 5), (1, 0), {"motion"}),
        ((6, 5), (2, 0), {"acceleration"}),
    ):
        end = Motion(np.array([after]), np.array([velocity]), np.zeros(1))
        assert kinds(verify_moves(HALL, start, end, inert)) == found
    unicycle = MoveLimits(speed_m_s=4.0, turn_rate_rad_s=math.pi / 2)
    for after, heading, found in (
        ((5, 5), math.pi / 2, set()),
        ((5, 6.9), math.pi / 4, {"motion"}),
        ((5, 6), math.pi / 2, {"speed"}),
        ((9, 5), 0.0, set()),
        ((1, 5), 0.0, set()),
        ((5, 5), 2.0, {"turn"}),
    ):
        end = Motion(np.array([after]), np.zeros((1, 2)), np.array([heading]))
        assert kinds(verify_moves(HALL, start, end, unicycle)) == found


def test_radio_is_verified_over_the_best_links() -> None:
    """An agent that its neighbour carries is connected; without the neighbour it is not."""
    far, near = (59.5, 20.0), (30.0, 10.0)
    still = places(near, far)
    limits = MoveLimits()
    assert verify_moves(shapely.box(0, 0, 60, 40), still, still, limits, RADIO) == ()
    alone = places(far)
    (fault,) = verify_moves(shapely.box(0, 0, 60, 40), alone, alone, limits, RADIO)
    length = math.hypot(*far)
    score = (-10.0 - 25.0 * math.log10(length) + 62.0) / 6.0
    assert fault.kind == "radio"
    assert fault.value == pytest.approx(0.5 * math.erfc(score / math.sqrt(2.0)), rel=1e-6)
    gone = places(near, (99.0, 59.0))
    assert kinds(verify_moves(shapely.box(0, 0, 100, 60), still, gone, limits, RADIO)) == {"radio"}


@pytest.mark.parametrize("kind", ["single", "double", "unicycle"])
def test_planned_moves_have_no_fault(kind: str) -> None:
    """Agents that are drawn apart and together keep bodies, borders, motion and radio."""
    bounds = {"double": {"acceleration_m_s2": 1.0}, "unicycle": {"turn_rate_rad_s": 1.0}}
    limits = MoveLimits(speed_m_s=3.0, body_radius_m=0.8, clearance_m=1.0, **bounds.get(kind, {}))
    rng = np.random.default_rng(9)
    grid = np.stack(np.meshgrid(np.arange(4, 20, 4.0), np.arange(4, 20, 4.0)), axis=2)
    agents = grid.reshape(-1, 2) + rng.random((16, 2))
    motion = Motion.at_rest(agents)
    radio = RadioLimits(RADIO.stations_m, KNOWN, KNOWN, -48.0, 0.9)
    wall = shapely.box(10.8, 20.5, 30, 30)
    ground = geodesic_ground(shapely.box(0, 0, 100, 100), [wall], 5.0, clearance_m=1.0)
    loosest, away = 0.0, agents
    for step in range(24):
        if step % 8 == 0:
            away = 200.0 * (rng.random((16, 2)) - 0.2)
        here = motion.places_m
        targets = ground.steered(here, np.clip(away, 2.0, 98.0), 0.5)
        stops = here + braking_offsets_m(motion.velocities_m_s, 1.0) if kind == "double" else here
        tree = radio_tree(here, radio, stops)
        assert tree.connected.all()
        loosest = max(loosest, float(tree.failure.max()))
        after = plan_moves(ground, motion, targets, limits, 0.5, 6, kept=tree.kept).motion
        assert verify_moves(ground.free, motion, after, limits, radio) == ()
        motion = after
    # Radio has been in the way: otherwise nothing was tested.
    assert 0.06 < loosest <= 0.1


def test_tree_counts_failures_of_the_whole_path() -> None:
    """The bound is the sum over the path, and the rest of the probability is divided over it."""
    chain = places((22, 0), (44, 0), (66, 0)).places_m
    radio = RadioLimits(RADIO.stations_m, KNOWN, KNOWN, -62.0, 0.7)
    tree = radio_tree(chain, radio)
    assert tree.parent.tolist() == [-1, 0, 1]
    score = (-10.0 - 25.0 * math.log10(22.0) + 62.0) / 6.0
    one = 0.5 * math.erfc(score / math.sqrt(2.0))
    np.testing.assert_allclose(tree.failure, [one, 2 * one, 3 * one], rtol=2e-2)
    # Each end at the edge of its disc: links are as long as they may get.
    reach = tree.kept.radii_m[tree.kept.disc_agent == 2][0] * 2.0
    score = (-10.0 - 25.0 * math.log10(reach) + 62.0) / 6.0
    assert 3.0 * 0.5 * math.erfc(score / math.sqrt(2.0)) == pytest.approx(0.3, rel=2e-2)
    uncertain = LinkLaw(KNOWN.theta, 6.0, np.diag([9.0, 0.04]))
    wary = RadioLimits(RADIO.stations_m, KNOWN, uncertain, -62.0, 0.7)
    assert radio_tree(chain, wary).failure[2] > tree.failure[2]


def test_law_without_radio_fails_where_tree_holds(square: ConvexRegion) -> None:
    """Radio binds: the same agents without the tree lose their connection."""
    start, limits = places((10, 10), (14, 10), (10, 14)), MoveLimits(speed_m_s=3.0)
    hall, targets = shapely.box(0, 0, 100, 100), np.full((3, 2), 95.0)
    for keeps in (True, False):
        now, lost = start, 0
        for _ in range(40):
            kept = radio_tree(now.places_m, RADIO).kept if keeps else UNBOUNDED
            after = plan_moves(ConvexGround(square), now, targets, limits, 0.5, 5, kept=kept).motion
            lost += len(verify_moves(hall, now, after, limits, RADIO))
            now = after
        assert (lost == 0) == keeps
        if keeps:
            assert np.linalg.norm(now.places_m, axis=1).max() > 30.0


BOUNDS = (0.0, 0.0, 120.0, 90.0)
THRESHOLD_DBM = -80.0


@pytest.fixture(scope="module")
def learnt() -> StationMap:
    """The map of two stations with 60 measurements each."""
    posteriors = []
    for number, place in enumerate([(10.0, 10.0), (100.0, 80.0)]):
        rng = np.random.default_rng(number)
        parameters = ChannelParameters(-30.0, 3.0, 6.0, 20.0, 1.0, Station(place))
        truth = model_truth(parameters, BOUNDS, 2.0, None, rng)
        posteriors.append(condition(parameters, measure(truth, rng.random((60, 2)) * BOUNDS[2:])))
    return station_map(posteriors, THRESHOLD_DBM, BOUNDS)


def test_nodes_stand_for_what_is_around_them(learnt: StationMap) -> None:
    """Nowhere within a node's disc does a link fail more than the map says."""
    rng = np.random.default_rng(5)
    places = rng.random((4000, 2)) * BOUNDS[2:]
    said = learnt.near(places[:400], places[:400])
    for station, posterior in enumerate(learnt.posteriors):
        fails = 1.0 - posterior.connectivity(places[:400], THRESHOLD_DBM)
        assert (said[:, station] >= fails - 1e-9).all()
        # The map is not idly cautious.
        assert np.median(said[:, station] - fails) < 0.03
    foot, away = line_distances_m(places, np.array([10.0, 20.0]), np.array([70.0, 60.0]))
    line = shapely.LineString([(10.0, 20.0), (70.0, 60.0)])
    np.testing.assert_allclose(away, shapely.distance(line, shapely.points(places)), atol=1e-9)
    assert float(shapely.distance(line, shapely.points(foot)).max()) < 1e-9


@pytest.mark.parametrize("inert", [False, True])
def test_places_that_are_kept_hold_all_links(learnt: StationMap, inert: bool) -> None:
    """Anywhere within the agents' safe sets, no link path to a station fails more than allowed."""
    law = LinkLaw(np.array([-30.0, 3.0]), 4.0, np.diag([1.0, 0.0]))
    radio = RadioLimits(np.array([[10.0, 10.0], [100.0, 80.0]]), learnt, law, THRESHOLD_DBM, 0.9)
    rng = np.random.default_rng(2)
    agents = rng.random((30, 2)) * BOUNDS[2:]
    stops = agents + (rng.normal(size=agents.shape) if inert else 0.0)
    tree = radio_tree(agents, radio, stops)
    direct = np.flatnonzero((tree.parent < 0) & tree.connected)
    who = np.flatnonzero(tree.connected)
    assert len(direct) >= 3 and len(who) >= 15
    assert tree.kept.holds(np.stack((agents, stops), axis=1), 1e-9).all()
    box, limits = shapely.box(*BOUNDS).buffer(200.0), MoveLimits()
    moved = 0.0
    for _ in range(20):
        ends = np.clip(agents + rng.normal(size=agents.shape) * 25.0, 0.0, BOUNDS[2:])
        share = tree.kept.share_inside(agents, ends)
        after = agents + share[:, None] * (ends - agents)
        moved += float(np.linalg.norm(after - agents, axis=1)[direct].mean()) / 20
        before, ended = Motion.at_rest(agents[who]), Motion.at_rest(after[who])
        assert not verify_moves(box, before, ended, limits, radio)
        again = radio_tree(after, radio)
        assert again.connected[who].all()
    assert moved > 0.5
