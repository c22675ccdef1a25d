"""Readings replace predictions at their positions: kinds of readings, several stations, draws."""

from dataclasses import replace

import numpy as np
import pytest

from planopt.channel import ChannelParameters, Measurements, Station, condition, joint_prediction
from planopt.channel.connectivity_law import ConnectivityLaw
from planopt.channel.kriging import connection_probability
from planopt.channel.measurements import SAME_PLACE_M
from planopt.channel.neighbours import MOST_UNTREED, PlaceIndex

THRESHOLD_DBM = -80.0
CHANNEL = ChannelParameters(-30.0, 2.5, 6.0, 10.0, 2.0, Station((0.0, 0.0)))
PLACES = np.array([[30.0, 5.0], [60.0, 9.0], [90.0, 30.0], [40.0, 40.0]])


def law_of(*tables, p_min=0.9, channel=CHANNEL):
    """The law of one station for each table."""
    stations = tuple(condition(channel, table, theta="known") for table in tables)
    return ConnectivityLaw(stations, (THRESHOLD_DBM,) * len(stations), p_min)


def chances(law, places):
    """P(connected) from the power that verifier and planner use."""
    power = law.power(places)
    return connection_probability(power.mean_db, power.deviation_db, THRESHOLD_DBM)


def test_a_reading_is_the_power_of_later_packets():
    """Exactly the measured power, and the margin it leaves, whatever p_min."""
    powers = np.array([-79.0, -81.0, -60.0, -99.0])
    law = law_of(Measurements(PLACES, powers))
    power = law.power(PLACES)
    np.testing.assert_array_equal(power.mean_db, powers)
    np.testing.assert_array_equal(power.deviation_db, 0.0)
    np.testing.assert_array_equal(chances(law, PLACES), [1.0, 0.0, 1.0, 0.0])
    np.testing.assert_array_equal(law.margin_db(PLACES), powers - THRESHOLD_DBM)
    np.testing.assert_array_equal(law.connected_m, PLACES[[0, 2]])


def test_other_positions_are_predicted():
    """Beyond rounding of a position nothing is known but shadowing."""
    law = law_of(Measurements(PLACES, np.full(4, -79.0)))
    there = PLACES + np.array([2.0 * SAME_PLACE_M, 0.0])
    (station,) = law.posteriors
    np.testing.assert_array_equal(law.power(there).mean_db, station.predict(there).mean_db)
    assert (law.power(there).deviation_db >= CHANNEL.multipath_std_db).all()
    near = PLACES + np.array([0.5 * SAME_PLACE_M, 0.0])
    np.testing.assert_array_equal(chances(law, near), 1.0)
    np.testing.assert_array_equal(
        law.predicted(PLACES).deviation_db, station.predict(PLACES).deviation_db
    )


def test_censored_and_rounded_readings():
    """Known where the whole interval is on one side of the threshold."""
    powers = np.array([-90.0, -75.0, -79.0, -81.5])
    table = Measurements(
        PLACES,
        powers,
        np.array([True, True, False, False]),
        resolution_db=np.array([0.0, 0.0, 2.0, 2.0]),
    )
    law = law_of(table)
    known = np.array([True, False, True, True])
    found = law.power(PLACES)
    np.testing.assert_array_equal(found.deviation_db == 0.0, known)
    np.testing.assert_array_equal(chances(law, PLACES)[known], [0.0, 1.0, 0.0])
    assert found.mean_db[0] <= -90.0
    assert -80.0 <= found.mean_db[2] <= -78.0 and -82.5 <= found.mean_db[3] <= -80.5
    wide = replace(table, resolution_db=np.array([0.0, 0.0, 4.0, 4.0]))
    assert (law_of(wide).power(PLACES[2:]).deviation_db > 0.0).all()


def test_repeated_readings_must_agree():
    """Two readings on one side show the connection, on both sides nothing."""
    twice = np.repeat(PLACES[:2], 2, axis=0)
    law = law_of(Measurements(twice, np.array([-79.0, -70.0, -79.0, -81.0])))
    np.testing.assert_array_equal(law.power(PLACES[:2]).deviation_db == 0.0, [True, False])
    assert -79.0 <= law.power(PLACES[:1]).mean_db[0] <= -70.0


@pytest.mark.parametrize(
    ("columns", "forgetting_s"),
    [({"position_std_m": np.ones(4)}, np.inf), ({"receiver": np.ones(4, int)}, np.inf), ({}, 9.0)],
)
def test_multipath_that_is_not_fixed_is_unknown(columns, forgetting_s):
    """Position errors, a receiver's offset, and a channel that changes."""
    table = Measurements(PLACES, np.full(4, -60.0), **columns)
    law = law_of(table, channel=replace(CHANNEL, forgetting_s=forgetting_s))
    assert (law.power(PLACES).deviation_db > 0.0).all()
    assert not law.is_connected(PLACES).any() and not len(law.connected_m)


def test_any_of_several_stations_connects():
    """One known connection is enough; known losses leave the chance of the other stations."""
    first = Measurements(PLACES[:2], np.array([-79.0, -99.0]))
    second = Measurements(PLACES[1:3], np.array([-98.0, -97.0]))
    law = law_of(first, second)
    found = chances(law, PLACES)
    assert found[0] == pytest.approx(1.0, abs=1e-12) and found[1] == pytest.approx(0.0, abs=1e-12)
    alone = law_of(first).predicted(PLACES[2:3])
    expected = connection_probability(alone.mean_db, alone.deviation_db, THRESHOLD_DBM)
    assert found[2] == pytest.approx(expected[0], rel=1e-9)
    np.testing.assert_array_equal(law.is_connected(PLACES), [True, False, False, False])
    assert law.probability(PLACES) == pytest.approx(found, rel=1e-12)


@pytest.mark.parametrize("count", [1, 2])
def test_a_packet_proves_the_connection(count):
    """Of one station or of several, in margins and draws; a contrary reading does not matter."""
    tables = [Measurements(PLACES[2:], np.array([-99.0, -79.0]))] * count
    before = law_of(*tables)
    law = replace(before, proven=PlaceIndex.of(PLACES[1:3]))
    found = chances(law, PLACES)
    np.testing.assert_array_equal(found[1:3], 1.0)
    np.testing.assert_array_equal(found[[0, 3]], chances(before, PLACES)[[0, 3]])
    np.testing.assert_array_equal(law.is_connected(PLACES), [False, True, True, True])
    assert (law.margin_db(PLACES[1:3]) >= 0.0).all()
    assert {tuple(place) for place in law.connected_m} == {tuple(place) for place in PLACES[1:]}
    assert law.probability(PLACES) == pytest.approx(found, rel=1e-12)
    if count == 1:
        assert (law.sample(PLACES[:2], 500, 3)[:, 1] >= THRESHOLD_DBM).all()


def test_draws_keep_known_powers():
    """Known powers in every draw; elsewhere the joint law of all measurements."""
    law = law_of(Measurements(PLACES[:2], np.array([-79.0, -99.0])))
    path = np.vstack([PLACES[:2], PLACES[:2] + 1.0])
    drawn = law.sample(path, 500, 3)
    np.testing.assert_array_equal(drawn[:, 0], -79.0)
    np.testing.assert_array_equal(drawn[:, 1], -99.0)
    (joint,) = law.along(path)
    whole = joint_prediction(law.posteriors[0], path)
    np.testing.assert_array_equal(joint.covariance_db2[2:, 2:], whole.covariance_db2[2:, 2:])
    np.testing.assert_array_equal(joint.mean_db[2:], whole.mean_db[2:])


@pytest.mark.parametrize("count", [5, MOST_UNTREED + 40])
def test_positions_found_in_and_after_the_tree(count):
    """Against all pairs, for an index that grew."""
    generator = np.random.default_rng(count)
    places = generator.integers(0, 12, (count, 2)).astype(float)
    index = PlaceIndex.of(places[: count - 3]).grown(places)
    centres = generator.integers(0, 12, (50, 2)) + generator.choice([0.0, 3e-7, 3e-6], (50, 2))
    away = np.linalg.norm(centres[:, None] - places, axis=2)
    np.testing.assert_array_equal(index.within(centres, SAME_PLACE_M), np.nonzero(away <= 1e-6))
