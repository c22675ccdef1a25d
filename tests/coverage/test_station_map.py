"""Links to stations by a learnt map: places that agents keep hold them, by the posterior itself."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from planopt.channel import ChannelParameters, Station, condition, measure, model_truth
from planopt.coverage.control.radio import radio_tree
from planopt.coverage.limits import (
    LinkLaw,
    Motion,
    MoveLimits,
    RadioLimits,
    StationMap,
    line_distances_m,
    station_map,
)
from planopt.coverage.verify import verify_moves

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
    """Wherever agents get within what they keep, no way to a station fails more than allowed."""
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
