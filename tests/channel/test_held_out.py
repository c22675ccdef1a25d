"""Holding out groups: nothing leaks, and the channel beats path loss alone, on real logs too."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from simulated_channel import simulated, subset

from planopt.channel.calibration import calibrate
from planopt.channel.held_out import (
    held_out_predictions,
    learn_channel,
    learn_marginal,
    learn_path_loss,
    walk_groups,
)
from planopt.channel.log_file import read_log
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.prediction import Prediction
from planopt.errors import InputError

CHANNEL = ChannelParameters(-30.0, 2.8, 6.0, 30.0, 2.0, Station((20.0, 35.0), 3.0))
CAMPUS = Path(__file__).parents[3] / "shared" / "data" / "campus"


def test_nothing_leaks():
    """What predicts a measurement never saw its group; each is predicted once, in order."""
    count = 40
    groups = np.repeat(np.arange(10), 4)
    measurements = Measurements(
        np.stack([np.arange(count), groups], axis=1).astype(float),
        np.zeros(count),
        np.zeros(count, dtype=bool),
    )
    seen = []

    def learn(training):
        def predict(positions):
            assert not set(positions[:, 1]) & set(training.positions_m[:, 1])
            seen.append(len(positions))
            return Prediction(positions[:, 0], np.ones(len(positions)))

        return predict

    found = held_out_predictions(measurements, groups, learn, 3, np.random.default_rng(0))
    np.testing.assert_array_equal(found.mean_db, np.arange(count))
    assert sorted(seen) == [12, 12, 16]


def test_channel_beats_path_loss():
    """On the model's own channel: smaller error, and intervals that hold."""
    measurements = simulated(CHANNEL, 3, 200, 200.0, 0.1)
    # Squares of 50 m as groups.
    groups = (measurements.positions_m // 50.0 @ [1.0, 10.0]).astype(int)
    found = {
        learn.__name__: calibrate(
            held_out_predictions(
                measurements,
                groups,
                partial(learn, station=CHANNEL.station),
                4,
                np.random.default_rng(1),
            ),
            measurements,
        )
        for learn in (learn_path_loss, learn_channel, learn_marginal)
    }
    assert found["learn_channel"].rmse_db < 0.95 * found["learn_path_loss"].rmse_db
    assert found["learn_marginal"].rmse_db < 0.95 * found["learn_path_loss"].rmse_db
    for calibration in found.values():
        at_95 = next(one for one in calibration.coverage if one.level == 0.95)
        assert 0.88 < at_95.share <= 1.0


def test_walks():
    """Day and block of time make a group; an endless block is the day."""
    day = np.array([0.0, 0.0, 0.0, 1.0, 1.0])
    t_s = np.array([0.0, 599.0, 600.0, 10.0, 1300.0])
    groups = walk_groups(day, t_s, 600.0)
    assert groups[0] == groups[1]
    assert len(set(groups[[0, 2, 3, 4]])) == 4
    np.testing.assert_array_equal(walk_groups(day, t_s, np.inf), day)


@pytest.mark.parametrize("block_s", [0.0, -1.0, float("nan")])
def test_bad_block(block_s):
    """A block that is no time."""
    with pytest.raises(InputError):
        walk_groups(np.zeros(2), np.zeros(2), block_s)


@pytest.mark.parametrize(
    ("labels", "folds"), [(np.zeros(40, int), 2), (np.arange(40), 1), (np.arange(3), 2)]
)
def test_bad_groups(labels, folds):
    """One group, one fold, labels that do not belong."""
    measurements = simulated(CHANNEL, 3, 40, 200.0)
    with pytest.raises(InputError):
        held_out_predictions(
            measurements,
            labels,
            partial(learn_path_loss, station=CHANNEL.station),
            folds,
            np.random.default_rng(0),
        )


@pytest.mark.skipif(not CAMPUS.is_dir(), reason="the campus logs are not here")
def test_campus():
    """Days held out whole, every tenth measurement of a real log: better than path loss alone."""
    file = CAMPUS / "honors.csv"
    table = np.genfromtxt(file, delimiter=",", names=True)
    rows = np.arange(0, len(table), 10)
    measurements = subset(read_log(file, censored_column="near_floor"), rows)
    groups = walk_groups(table["day"][rows], table["t_s"][rows], np.inf)
    station = Station((507.4, -66.6))
    error = {}
    for learn in (learn_path_loss, learn_channel):
        found = calibrate(
            held_out_predictions(
                measurements, groups, partial(learn, station=station), 5, np.random.default_rng(0)
            ),
            measurements,
        )
        error[learn.__name__] = found.rmse_db
        at_90 = next(one for one in found.coverage if one.level == 0.9)
        assert 0.83 < at_90.share < 0.97
    assert error["learn_channel"] < 0.92 * error["learn_path_loss"]
