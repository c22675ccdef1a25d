"""Margins at lattice nodes: the cached map, corrected by the exact posterior where asked."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scenes import small_road_map
from terms_scene import TRACKING, context_of, scorer_of, terms_problem

from planopt import Measurements
from planopt.channel import ChannelParameters, Station, condition
from planopt.channel.connectivity_law import ConnectivityLaw
from planopt.channel.kriging import predict
from planopt.channel.neighbours import PlaceIndex
from planopt.planning.search.node_margins import NodeField, NodeMargins

PARAMETERS = ChannelParameters(-35.0, 2.8, 5.0, 4.0, 2.0, Station((3.0, -4.0), 6.0))
THRESHOLD, P_MIN = -70.0, 0.9
Z_90 = 1.2815515655446004


def data(count, seed=0):
    generator = np.random.default_rng(seed)
    positions = generator.uniform((0.0, 0.0), (10.0, 8.0), (count, 2))
    power = -68.0 + 4.0 * np.sin(positions[:, 0]) + generator.standard_normal(count)
    return Measurements(positions, power, np.zeros(count, dtype=bool))


def exact(posterior, places):
    """Margin by the full posterior, the bound written out."""
    power = predict(posterior, places)
    return power.mean_db - Z_90 * power.deviation_db - THRESHOLD


@pytest.fixture
def road_map():
    """A lattice with a block in it."""
    return small_road_map(shapely.box(4.0, 3.0, 6.0, 5.0), spacing_m=0.5)


@pytest.fixture
def margins(road_map):
    return NodeMargins(road_map, THRESHOLD, P_MIN)


def test_few_measurements_make_the_map_exact(road_map, margins):
    """Where a tile takes every measurement there is, all nodes have the exact margin."""
    posterior = condition(PARAMETERS, data(20))
    margins.refresh(ConnectivityLaw((posterior,), (0.0,), 0.5))
    np.testing.assert_allclose(margins.margin_db, exact(posterior, road_map.nodes_m), atol=1e-8)


def test_many_measurements_are_near_and_exact_where_corrected(road_map, margins):
    """The map is off by little; corrected nodes are exact, the others stay as they were."""
    posterior = condition(PARAMETERS, data(200))
    margins.refresh(ConnectivityLaw((posterior,), (0.0,), 0.5))
    before = margins.margin_db.copy()
    wanted = exact(posterior, road_map.nodes_m)
    assert 0.0 < np.abs(before - wanted).max() < 1.0
    nodes = np.array([3, 50, 3, 17])
    assert margins.correct(nodes)
    np.testing.assert_allclose(margins.margin_db[nodes], wanted[nodes], atol=1e-9)
    others = np.setdiff1d(np.arange(len(before)), nodes)
    np.testing.assert_array_equal(margins.margin_db[others], before[others])


def test_places_have_the_power_of_the_nearest_node_of_the_window():
    """Also beyond the window, and at the border of the lattice; none where nodes are not free."""
    context, belief = context_of(terms_problem(TRACKING))
    lattice = scorer_of(context, belief)[1].road_map.lattice
    field = NodeField(lattice)
    field.refresh(context, 12.0)
    rows, columns = np.mgrid[field.window].reshape(2, -1)
    inside = (rows < lattice.shape[0]) & (columns < lattice.shape[1])
    nodes = np.column_stack([rows, columns])[inside]
    places = context.position_m + np.random.default_rng(0).uniform(-14.0, 14.0, (300, 2))
    away = np.linalg.norm(places[:, None] - field.places_m(nodes), axis=2)
    beside = nodes[away.argmin(axis=1)]
    found = field.nearest(places)
    np.testing.assert_array_equal(found.mean_db, field.mean_db[*beside.T])
    np.testing.assert_array_equal(found.deviation_db, field.deviation_db[*beside.T])
    free = lattice.free[*beside.T]
    assert 0 < np.isnan(found.mean_db).sum() == np.sum(~free)


def test_nodes_from_which_packets_arrived_are_connected():
    """Their power is above the threshold without a deviation, as where it was measured."""
    context, belief = context_of(terms_problem(TRACKING, p_min=0.6))
    field = NodeField(scorer_of(context, belief)[1].road_map.lattice)
    field.refresh(context, 12.0)
    near = np.argwhere(field.deviation_db[field.window] > 0.0)[:1]
    node = near + [each.start for each in field.window]
    arrived = replace(context.history, connected=PlaceIndex.of(field.places_m(node)))
    field.refresh(replace(context, history=arrived), 12.0)
    assert field.deviation_db[*node[0]] == 0.0
    assert field.mean_db[*node[0]] >= context.law.thresholds_dbm[0]
