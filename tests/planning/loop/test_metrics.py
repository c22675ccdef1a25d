"""What a run is judged by, against sums by hand and brute force."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planopt import Verdict
from planopt.extend import Rung
from planopt.planning.loop.log import StepLog
from planopt.planning.loop.metrics import longest_outage_m, metrics_of


def log_of(positions, connected, connectivity=None, step_s=0.5):
    """A log of these places; what no metric reads is NaN."""
    positions = np.array(positions, dtype=float)
    count = len(positions)
    nan = np.full(count, np.nan)
    return StepLog(
        t_s=step_s * np.arange(count),
        positions_m=positions,
        predicted_dbm=nan,
        deviation_db=nan,
        connectivity=np.full(count, 0.95) if connectivity is None else np.array(connectivity),
        true_dbm=nan,
        connected=np.array(connected, dtype=bool),
        step_s=nan,
        polish_gain_s=nan,
        relaxation_db=nan,
        rung=(Rung.PLAN,) * count,
        verdict=(Verdict.VERIFIED,) * count,
    )


PLACES = [[0, 0], [3, 0], [3, 4], [3, 4], [3, 6]]
PLANS = [SimpleNamespace(polish_gain=gain) for gain in (0.1, 0.0)]


def test_metrics_by_hand():
    """Four steps, two of them connected, the start's own state not counted."""
    log = log_of(PLACES, [False, True, False, False, True], [0.1, 0.9, 0.6, 0.7, 0.8])
    metrics = metrics_of(log, PLANS, [True, False, True, True], 4)
    assert metrics.goal_time_s == 2.0
    assert metrics.path_m == 9.0
    assert metrics.true_connected_share == 0.5
    assert metrics.longest_outage_m == 4.0
    assert metrics.predicted_min_connectivity == 0.6
    assert metrics.polish_gain == pytest.approx(0.05)
    assert metrics.measured_steps == 3


def test_steps_without_a_share_are_left_out_of_the_mean_gain():
    """One of three has none; where no step has one the run has none, nor a time without goal."""
    log = log_of(PLACES, [True] * 5)
    assert np.isnan(metrics_of(log, PLANS, [], None).goal_time_s)
    assert metrics_of(log, PLANS, [], None).longest_outage_m == 0.0
    none = SimpleNamespace(polish_gain=np.nan)
    assert metrics_of(log, [*PLANS, none], [], None).polish_gain == pytest.approx(0.05)
    assert np.isnan(metrics_of(log, [none], [], None).polish_gain)


def test_a_run_of_no_step():
    """At the goal from the start: no time, no way, and nothing to tell of steps."""
    metrics = metrics_of(log_of([[1, 2]], [False], [np.nan]), [], [], 0)
    assert metrics.goal_time_s == 0.0
    assert metrics.path_m == 0.0
    assert np.isnan(metrics.true_connected_share) and np.isnan(metrics.longest_outage_m)
    assert np.isnan(metrics.predicted_min_connectivity) and np.isnan(metrics.polish_gain)
    assert metrics.measured_steps == 0


def brute_force_outage(lengths, connected):
    """Longest run of consecutive steps that all end without a connection, over all runs."""
    runs = [
        sum(lengths[a:b])
        for a in range(len(lengths))
        for b in range(a + 1, len(lengths) + 1)
        if not any(connected[a:b])
    ]
    return max(runs, default=0.0)


STEPS = st.lists(st.tuples(st.floats(0.0, 10.0), st.booleans()), max_size=15)


@settings(deadline=None)
@given(STEPS)
def test_longest_outage_is_the_longest_of_all_runs(steps):
    """By listing every run of steps."""
    lengths, connected = [s[0] for s in steps], [s[1] for s in steps]
    found = longest_outage_m(np.array(lengths), np.array(connected, dtype=bool))
    assert found == pytest.approx(brute_force_outage(lengths, connected), abs=1e-12)


@settings(deadline=None)
@given(STEPS, st.integers(0, 14))
def test_an_outage_more_is_no_shorter(steps, which):
    """Losing one more connection never shortens the longest outage; reversing keeps it."""
    if not steps:
        return
    lengths = np.array([s[0] for s in steps])
    connected = np.array([s[1] for s in steps])
    before = longest_outage_m(lengths, connected)
    assert longest_outage_m(lengths[::-1], connected[::-1]) == pytest.approx(before)
    connected[which % len(steps)] = False
    assert longest_outage_m(lengths, connected) >= before
    assert longest_outage_m(lengths, np.zeros(len(steps), dtype=bool)) == pytest.approx(
        lengths.sum()
    )


def test_a_stand_without_connection_neither_ends_nor_lengthens_an_outage():
    """Two steps of an outage with a stand between them are one outage."""
    lengths = np.array([2.0, 0.0, 3.0, 1.0])
    assert longest_outage_m(lengths, np.array([False, False, False, True])) == 5.0
    assert longest_outage_m(lengths, np.array([False, True, False, True])) == 3.0
