"""What a run is judged by, against sums by hand and brute force."""

from types import SimpleNamespace

import numpy as np
import pytest

from planopt import Verdict
from planopt.extend import Rung
from planopt.planning.loop.log import StepLog
from planopt.planning.loop.metrics import metrics_of


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
        true_dbm=np.where(connected, -60.0, -90.0),
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
