"""The closed loop: arrival, standstill, what is measured, and a log that agrees with itself."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scenes import CUP, bad_band, good_everywhere, prepared_of, small_problem

from planopt import InputError, Run, Verdict, load
from planopt.channel import LogFormat, true_power_dbm
from planopt.extend import Rung
from planopt.planning.files.result_json import run_json
from planopt.planning.loop.log import Outcome, StepLog
from planopt.planning.solve import simulate
from planopt.problems import LoggedMeasurements

SEEDS = (0, 1, 2)


@pytest.fixture(scope="module")
def driven() -> dict[int, Run]:
    """The library's open field on a few seeds."""
    problem = load("open_field")
    return {seed: simulate(problem, seed=seed) for seed in SEEDS}


@pytest.mark.parametrize("seed", SEEDS)
def test_goal_is_reached(driven, seed):
    done = driven[seed]
    problem, log = done.problem, done.run.log
    assert done.run.outcome is Outcome.REACHED
    assert done.exit_code == 0
    goal = np.asarray(problem.robots[0].goal_m)
    away = np.linalg.norm(log.positions_m - goal, axis=1)
    assert away[-1] <= problem.constraints.goal_radius_m < away[:-1].min()
    assert done.run.metrics.goal_time_s == pytest.approx(2.0 * (len(away) - 1))


@pytest.mark.parametrize("seed", SEEDS)
def test_log_agrees_with_itself(driven, seed):
    """One row a step and one for the start; each row is what its plan predicted."""
    done = driven[seed]
    log, plans = done.run.log, done.plans[0]
    rows = len(plans) + 1
    assert all(len(getattr(log, column.name)) == rows for column in fields(StepLog))
    assert (log.positions_m[0] == done.problem.robots[0].start_m).all()
    for k, plan in enumerate(plans):
        assert (plan.positions_m[0] == log.positions_m[k]).all()
        assert (plan.positions_m[1] == log.positions_m[k + 1]).all()
        assert plan.mean_dbm[1] == log.predicted_dbm[k + 1]
        assert plan.deviation_db[1] == log.deviation_db[k + 1]
        assert plan.connectivity[1] == log.connectivity[k + 1]
        assert log.rung[k + 1] is plan.rung
        assert log.verdict[k + 1] is plan.verdict
        assert log.polish_gain_s[k + 1] == plan.lattice_objective - plan.objective >= 0.0
        assert log.step_s[k + 1] == plan.wall_s >= plan.solve_s
    assert (log.t_s == 2.0 * np.arange(rows)).all()
    assert (log.true_dbm == true_power_dbm(done.truths[0], log.positions_m)).all()
    threshold = done.problem.stations[0].threshold_dbm
    assert (log.connected == (log.true_dbm >= threshold)).all()
    assert log.rung[0] is Rung.PLAN and log.verdict[0] is Verdict.VERIFIED
    assert sum(done.run.rungs.values()) == rows - 1


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_measured(driven, seed):
    """Each driven place that is far enough from every earlier one, with the truth there."""
    done = driven[seed]
    measured, first = done.belief.posterior.measurements, done.first_measurements
    assert first == 120
    spacing = done.problem.channel.measure_spacing_m
    known = list(measured.positions_m[:first])
    expected = []
    for place in done.run.log.positions_m[1:]:
        if min(np.linalg.norm(np.array(known) - place, axis=1)) >= spacing:
            known.append(place)
            expected.append(place)
    assert len(expected) > 5
    assert (measured.positions_m[first:] == np.array(expected)).all()
    truth = true_power_dbm(done.truths[0], np.array(expected))
    assert (measured.power_dbm[first:] == truth).all()


def test_same_seed_same_run(driven):
    """Bit for bit, but for the measured times."""
    again = simulate(load("open_field"), seed=1)
    for column in fields(StepLog):
        if column.name != "step_s":
            one, other = (getattr(s.run.log, column.name) for s in (driven[1], again))
            assert np.array_equal(one, other)
    assert again.run.metrics == driven[1].run.metrics
    one, other = (s.belief.posterior.measurements for s in (driven[1], again))
    assert np.array_equal(one.power_dbm, other.power_dbm)


def small_run(problem, power_at=good_everywhere, **options) -> Run:
    """Drive in a power that the test chose."""
    return simulate(problem, prepared=prepared_of(problem, power_at), **options)


def test_steps_and_their_limit():
    """One report after each step; a loop that has not arrived by the limit ends and says so."""
    seen = []
    done = small_run(small_problem(CUP), on_step=seen.append)
    assert done.run.outcome is Outcome.REACHED
    assert seen == list(range(1, len(done.plans[0]) + 1))
    done = small_run(small_problem(max_steps=3))
    assert done.run.outcome is Outcome.STEP_LIMIT
    assert "3 steps" in done.run.reason
    assert len(done.plans[0]) == 3
    assert np.isnan(done.run.metrics.goal_time_s)
    assert done.exit_code == 4


def test_start_within_the_goal_radius():
    done = small_run(small_problem(goal_m=(5.5, 15.0)))
    assert done.run.outcome is Outcome.REACHED
    assert done.plans[0] == ()
    assert done.run.log.positions_m.shape == (1, 2)
    assert done.run.metrics.goal_time_s == 0.0
    assert done.exit_code == 0
    # Nothing was verified and nobody connected: that is no success of 100 %.
    told = run_json(done)
    null = ("true_connected_share", "longest_outage_m", "predicted_min_connectivity", "polish_gain")
    assert told["verified_rate"] is None and told["robots"][0]["verified_rate"] is None
    assert [told["metrics"][name] for name in null] == [None] * len(null)
    assert "no step was driven" in repr(done)


def test_circling_is_a_stall(monkeypatch):
    """To and fro over known ground without end is one too."""
    from planopt.planning.team import team_step

    class Pacing(team_step.ReachPlanner):
        def release(self, outlook, warm=None, moving=None, reserved_m=None):
            plan, position_m = super().release(outlook), outlook.state[:2]
            there = np.array([5.0, 15.0]) if position_m[0] > 5.5 else np.array([6.0, 15.0])
            return replace(plan, positions_m=np.vstack([position_m, there, there]))

    monkeypatch.setattr(team_step, "ReachPlanner", Pacing)
    done = small_run(small_problem(horizon=2, planner="lattice"))
    assert done.run.outcome is Outcome.STALLED
    assert "of one place for 30 steps" in done.run.reason
    assert 30 <= len(done.plans[0]) <= 32


@pytest.mark.parametrize("horizon", [4, 8])
def test_gap_that_must_be_crossed(horizon):
    """No way keeps the bound: the gap is crossed by relaxed steps that say why, to the goal."""
    problem = small_problem(
        bounds_m=(0.0, 0.0, 28.0, 6.0),
        start_m=(3.0, 3.0),
        goal_m=(25.0, 3.0),
        horizon=horizon,
        max_steps=200,
    )
    done = small_run(problem, bad_band(6.0, 10.0))
    assert done.exit_code == 0
    relaxed = [plan for plan in done.plans[0] if plan.certificate.relaxed_steps]
    assert relaxed
    assert all(plan.verdict is Verdict.VERIFIED for plan in relaxed)
    assert all(
        plan.certificate.path_cost_m <= 1.05 * plan.certificate.best_cost_m + 44.0
        for plan in relaxed
    )
    assert (done.run.log.relaxation_db > 0.0).any()
    assert done.run.metrics.longest_outage_m <= 12.0
    # The saved run says of each such step by how much it misses the bound, and what excuses it.
    told = run_json(done)["robots"][0]["excused"]
    below = np.flatnonzero(done.run.log.relaxation_db > 0.0)
    assert [one["step"] for one in told] == below.tolist()
    np.testing.assert_allclose(
        [one["relaxation_db"] for one in told], done.run.log.relaxation_db[below]
    )
    assert {one["excuse"] for one in told} == {"price"}


def test_simulation_needs_a_truth():
    problem = small_problem()
    prepared = replace(prepared_of(problem), truths=())
    with pytest.raises(InputError, match=r"channel\.truth"):
        simulate(problem, prepared=prepared)


def test_first_measurements_from_a_log(tmp_path):
    """The log is what is known at first; the drawn truth is what is driven in."""
    problem = load("open_field")
    taken = simulate(replace(problem, planner=replace(problem.planner, max_steps=1)), seed=3)
    measured = taken.belief.posterior.measurements
    rows = np.column_stack([measured.positions_m[:60], measured.power_dbm[:60]])
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, delimiter=",", header="east,north,rssi", comments="", fmt="%.17g")
    setup = LoggedMeasurements(path, LogFormat(("east", "north", "rssi")))
    logged = replace(problem, channel=replace(problem.channel, measurements=setup))
    done = simulate(logged, seed=3)
    assert done.first_measurements == 60
    assert np.array_equal(done.truths[0].raster.values, taken.truths[0].raster.values)
    assert np.array_equal(
        done.belief.posterior.measurements.power_dbm[:60], measured.power_dbm[:60]
    )
    assert done.run.outcome in (Outcome.REACHED, Outcome.STALLED)
