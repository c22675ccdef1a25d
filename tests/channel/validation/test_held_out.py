"""Holding out groups: nothing leaks, and the channel beats path loss alone."""

import numpy as np
import pytest
from simulated_channel import simulated

from planopt import InputError
from planopt.channel import ChannelParameters, Measurements, Prediction, Station
from planopt.channel.held_out import (
    deal,
    held_out_predictions,
)

CHANNEL = ChannelParameters(-30.0, 2.8, 6.0, 30.0, 2.0, Station((20.0, 35.0), 3.0))


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
        def predict(readings):
            assert not set(readings.positions_m[:, 1]) & set(training.positions_m[:, 1])
            seen.append(len(readings))
            return Prediction(readings.positions_m[:, 0], np.ones(len(readings)))

        return {"one": predict}

    fold_of = deal(groups, 3, np.random.default_rng(0))
    found = held_out_predictions(measurements, fold_of, learn)
    np.testing.assert_array_equal(found["one"].mean_db, np.arange(count))
    assert sorted(seen) == [12, 12, 16]


def test_groups_stay_together():
    """Every group is in one fold, and every fold has a group, up to one group a fold."""
    groups = np.array([4, 4, 7, 7, 7, 1, 2, 2])
    for folds in (2, 3, 4):
        fold_of = deal(groups, folds, np.random.default_rng(5))
        assert set(fold_of) == set(range(folds))
        assert all(len(set(fold_of[groups == label])) == 1 for label in groups)


@pytest.mark.parametrize("folds", [1, 4])
def test_bad_folds(folds):
    """One fold, or more than groups."""
    with pytest.raises(InputError):
        deal(np.array([0, 1, 2, 2]), folds, np.random.default_rng(0))


@pytest.mark.parametrize("fold_of", [np.zeros(40, int), np.arange(3)])
def test_bad_fold_labels(fold_of):
    """Nothing to learn from, or labels that do not belong."""
    with pytest.raises(InputError):
        held_out_predictions(simulated(CHANNEL, 3, 40, 200.0), fold_of, lambda _: {})
