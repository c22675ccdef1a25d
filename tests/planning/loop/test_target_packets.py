"""The station's filter where packets have estimates, and where they come late."""

import json
from dataclasses import replace

import numpy as np
import pytest

from planopt import InputError, check, load, simulate
from planopt.channel import condition
from planopt.planning.loop.metrics import run_metrics
from planopt.planning.loop.results import summary_of
from planopt.planning.stepping import aim_of, counted, watch_target
from planopt.targets.information_filter import predict, predicted_information

STEPS = 6
PLACES = np.array([[20.0, 30.0], [32.0, 26.0], [26.0, 16.0]])
DELIVERED = np.random.default_rng(3).uniform(size=(STEPS, 3)) < 0.4
MEASURED = 28.0 + np.random.default_rng(4).normal(size=(STEPS, 3, 2))

HELD_TOLERANCE = 0.02
"""A plan takes the noise of held measurements at the station's estimate, the robot at its own."""


def watched(packets="measurements", delay=0, robots=3):
    """The filters after each step of a few robots that stand and send."""
    problem = load("outdoor_track")
    target = replace(problem.targets[0], packets=packets, packet_delay_steps=delay)
    problem = replace(problem, targets=(target,), robots=problem.robots[:robots])
    found = [watch_target(problem, np.random.default_rng(0))]
    for measured, delivered in zip(MEASURED, DELIVERED, strict=True):
        found.append(counted(found[-1], measured[:robots], PLACES[:robots], delivered[:robots]))
    return found


def test_an_estimate_restores_the_station():
    """After any packet of the only robot the station knows what the robot knows; else it waits."""
    watches = watched("estimates", robots=1)
    for before, after, arrived in zip(watches[:-1], watches[1:], DELIVERED[:, 0], strict=True):
        expected = after.robots[0] if arrived else predict(after.model, before.station)
        np.testing.assert_allclose(after.station.matrix, expected.matrix, rtol=1e-10)
        np.testing.assert_allclose(after.station.vector, expected.vector, rtol=1e-10)
    assert 0 < DELIVERED[:, 0].sum() < STEPS


def test_estimates_of_several_robots_are_all_that_they_measured():
    """The filter of every measurement up to each robot's last packet, counted once, in order."""
    watches = watched("estimates")
    last = [np.flatnonzero(DELIVERED[:, i]).max(initial=-1) for i in range(3)]
    heard = np.arange(STEPS)[:, None] <= last
    again = watched()[0]
    for measured, row in zip(MEASURED, heard, strict=True):
        again = counted(again, measured, PLACES, row)
    np.testing.assert_allclose(watches[-1].station.matrix, again.station.matrix, rtol=1e-10)
    np.testing.assert_allclose(watches[-1].station.vector, again.station.vector, rtol=1e-10)
    raw = watched()[-1]
    assert watches[-1].station_variance_m2 <= raw.station_variance_m2


def test_plans_know_what_a_robot_holds():
    """The station's filter with what is held is the robot's own, with what is known its own."""
    for watch in watched("estimates", robots=1):
        held = aim_of(watch, 0, 3).held
        assert held is not None
        for told, expected in (
            (held.known, watch.station.matrix),
            (held.known + held.sent, watch.robots[0].matrix),
        ):
            matrix = held.information
            for each in told:
                matrix = predicted_information(watch.model, matrix)
                matrix[:2, :2] += each * np.eye(2)
            np.testing.assert_allclose(matrix, expected, rtol=HELD_TOLERANCE)
    assert {aim_of(watch, 0, 3).held for watch in watched("measurements")} == {None}
    several = [aim_of(watched("estimates")[-1], robot, 3).held for robot in range(3)]
    last = [STEPS - 1 - np.flatnonzero(DELIVERED[:, i]).max(initial=-1) for i in range(3)]
    assert [held.steps for held in several if held is not None] == last


@pytest.mark.parametrize("packets", ["measurements", "estimates"])
def test_late_packets_are_those_of_before(packets):
    """With a delay of two steps the station predicts twice from what it knew without one."""
    on_time, late = watched(packets), watched(packets, delay=2)
    for step in range(2, STEPS + 1):
        expected = on_time[step - 2].station
        for _ in range(2):
            expected = predict(late[step].model, expected)
        np.testing.assert_allclose(late[step].station.matrix, expected.matrix, rtol=1e-9)
        np.testing.assert_allclose(late[step].station.vector, expected.vector, rtol=1e-9)


def test_a_run_of_estimates_is_judged_from_its_files(tmp_path):
    """The check finds the same filter; the station knows more than from raw measurements."""
    problem = load("fig4")
    problem = replace(problem, planner=replace(problem.planner, max_steps=12, horizon=1))
    raw = simulate(problem, seed=1)
    target = replace(problem.targets[0], packets="estimates", packet_delay_steps=1)
    run = simulate(replace(problem, targets=(target,)), seed=1)
    run.save(tmp_path / "run")
    assert check(tmp_path / "run").reasons == ()
    assert run.target is not None and raw.target is not None
    assert not np.array_equal(run.target.station_variance_m2, raw.target.station_variance_m2)


def with_receiver(receive_dbm):
    """Six steps of fig4, the station hearing what arrives at so many dBm."""
    problem = load("fig4")
    station = replace(problem.stations[0], receive_threshold_dbm=receive_dbm)
    planner = replace(problem.planner, max_steps=6, horizon=1)
    return replace(problem, stations=(station,), planner=planner)


def test_the_receiver_decides_on_packets_and_plans_do_not_know(tmp_path):
    """A deaf station gets nothing; plans have the chances of the threshold that they were told."""
    deaf = simulate(with_receiver(60.0), seed=1)
    assert deaf.target is not None and not deaf.target.delivered.any()
    assert deaf.metrics["true_connected_share"] == 0.0
    told = simulate(with_receiver(None), seed=1)
    same = simulate(with_receiver(told.problem.stations[0].threshold_dbm), seed=1)
    assert told.target is not None and same.target is not None and told.target.delivered.any()
    np.testing.assert_array_equal(told.target.delivered, same.target.delivered)
    for one, other in zip(told.runs, deaf.runs, strict=True):
        assert one.log.connectivity[1] == other.log.connectivity[1]
        assert not other.log.connected.any()
    deaf.save(tmp_path / "run")
    assert check(tmp_path / "run").reasons == ()


def test_a_receiver_that_hears_its_own_floor_is_refused():
    problem = with_receiver(-95.0)
    truth = replace(problem.channel.truth, floor_db=-90.0)
    with pytest.raises(InputError, match=r"stations\[0\].receive_threshold_dbm"):
        simulate(replace(problem, channel=replace(problem.channel, truth=truth)), seed=1)


def test_robots_that_share_know_what_all_have_measured(tmp_path):
    """One belief of all: the first measurements, and those of all robots in turn."""
    problem = with_receiver(None)
    shared = replace(problem, channel=replace(problem.channel, share_measurements=True))
    own, run = simulate(problem, seed=2), simulate(shared, seed=2)
    alone = [len(belief.posterior.measurements) for belief in own.beliefs]
    together = {len(belief.posterior.measurements) for belief in run.beliefs}
    assert len(together) == 1 and together.pop() > max(alone)
    found = run.beliefs[0].posterior
    again = condition(found.parameters, found.measurements, theta="known")
    places = np.random.default_rng(0).uniform(5.0, 75.0, (40, 2))
    np.testing.assert_allclose(found.predict(places).mean_db, again.predict(places).mean_db)
    tracks = np.stack([one.log.positions_m[1:] for one in run.runs], axis=1).reshape(-1, 2)
    on_the_way = found.measurements.positions_m[run.first_measurements :]
    order = [np.flatnonzero((tracks == place).all(axis=1))[0] for place in on_the_way]
    assert order == sorted(order) and len({number % 3 for number in order}) == 3
    run.save(tmp_path / "run")
    assert check(tmp_path / "run").reasons == ()
    file = tmp_path / "run" / "run.json"
    data = json.loads(file.read_text())
    assert data["problem_file"]["channel"]["measurements"].pop("shared") is True
    file.write_text(json.dumps(data))
    assert check(tmp_path / "run").reasons != ()


def test_a_target_is_lost_above_three_times_the_first_trace():
    """Once is enough; the trace over time goes into summaries of the run."""
    run = simulate(with_receiver(None), seed=1)
    assert run.metrics["target_lost"] == 0.0
    np.testing.assert_array_equal(summary_of(run).traces["trace_p"], run.target.station_variance_m2)
    for largest, lost in ((2.99, 0.0), (3.01, 1.0)):
        trace = run.target.station_variance_m2.copy()
        trace[3] = largest * trace[0]
        target = replace(run.target, station_variance_m2=trace)
        found = run_metrics(run.problem, run.runs, target, None, {})
        assert found["target_lost"] == lost
