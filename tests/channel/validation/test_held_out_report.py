"""Scores of held-out walks: against sums by hand, and on a real log where it is there."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from simulated_channel import simulated

from planopt import InputError
from planopt.channel import (
    ChannelParameters,
    LogFormat,
    Measurements,
    Prediction,
    Station,
    fit_channel,
    held_out_report,
    predictors_of,
    read_log,
)
from planopt.channel.held_out import deal, learn_path_loss
from planopt.channel.power_log import parse_groups, read_groups

PREDICTORS = ["channel", "marginal", "path_loss", "plain_line", "plain_process"]
CHANNEL = ChannelParameters(-30.0, 2.8, 6.0, 30.0, 2.0, Station((20.0, 35.0), 3.0))
CAMPUS = Path(__file__).parents[4] / "shared" / "data" / "campus"


def constant(mean_db):
    """A predictor of `mean_db` with deviation 1 dB."""
    return lambda readings: Prediction(np.full(len(readings), mean_db), np.ones(len(readings)))


def test_scores_by_hand():
    """Two groups with errors 0, 1, 1 and 3: squares, their ratio, and what is inside 95 %."""
    power = np.array([0.0, 1.0, -1.0, 3.0, 9.0])
    censored = np.array([False, False, False, False, True])
    measurements = Measurements(np.zeros((5, 2)), power, censored)
    groups = np.array([0, 0, 1, 1, 1])
    found = held_out_report(
        measurements, groups, groups, lambda _: {"path_loss": constant(2.0), "a": constant(0.0)}
    )
    assert (found.groups, found.fold_sizes, found.measurements, found.censored) == (2, (2, 3), 5, 1)
    score = found.scores["a"]
    assert score.rmse_db.value == pytest.approx(np.sqrt(11.0 / 4.0))
    assert score.of_path_loss.value == pytest.approx(np.sqrt(11.0 / (4.0 + 1.0 + 9.0 + 1.0)))
    # The limit is far above: all that it allows is inside in the share 0.95.
    assert score.coverage[0.95].value == pytest.approx((3.0 + 0.95) / 5.0)
    assert score.calibration.rmse_db == pytest.approx(score.rmse_db.value)
    assert found.scores["path_loss"].of_path_loss.value == 1.0
    for ratio in (score.rmse_db, score.of_path_loss, *score.coverage.values()):
        assert ratio.low <= ratio.value <= ratio.high


def test_only_limits_have_no_error():
    """Where nothing but upper limits was held out there is nothing to report."""
    measurements = Measurements(np.zeros((4, 2)), np.full(4, 9.0), np.ones(4, dtype=bool))
    groups = np.array([0, 0, 1, 1])
    with pytest.raises(InputError):
        held_out_report(measurements, groups, groups, lambda _: {"path_loss": constant(0.0)})
    with pytest.raises(InputError, match="upper limits"):
        learn_path_loss(measurements, CHANNEL.station)


def test_groups_do_not_belong():
    """One label a measurement."""
    with pytest.raises(InputError):
        held_out_report(simulated(CHANNEL, 1, 20, 100.0), np.zeros(3, int), np.zeros(20, int), dict)


def test_channel_and_marginal_beat_path_loss():
    """On the model's own channel, with one fit a fold for both."""
    measurements = simulated(CHANNEL, 3, 160, 200.0, 0.1)
    groups = (measurements.positions_m // 20.0 @ [1.0, 10.0]).astype(int)
    fits = []

    def fit(training):
        fits.append(len(training))
        return fit_channel(training, CHANNEL.station)

    fold_of = deal(groups, 4, np.random.default_rng(1))
    found = held_out_report(measurements, groups, fold_of, predictors_of(fit))
    assert list(found.scores) == PREDICTORS
    assert len(fits) == 4 and sum(fits) == 3 * 160
    assert found.scores["plain_process"].rmse_db.value > found.scores["channel"].rmse_db.value
    for name in ("channel", "marginal"):
        score = found.scores[name]
        assert score.of_path_loss.high < 1.0
        assert 0.88 < score.coverage[0.95].value <= 1.0


def test_many_measurements_are_marginalised_by_the_nearest(monkeypatch):
    """Beyond the limit there are no factors, and the predictions are all but the same."""
    learn = predictors_of(partial(fit_channel, station=CHANNEL.station))
    known, more = simulated(CHANNEL, 3, 150, 200.0), simulated(CHANNEL, 4, 40, 200.0)
    exact = learn(known)["marginal"](more)
    monkeypatch.setattr("planopt.channel.held_out.MARGINAL_EXACT_LIMIT", 100)
    near = learn(known)["marginal"](more)
    assert not np.array_equal(near.mean_db, exact.mean_db)
    np.testing.assert_allclose(near.mean_db, exact.mean_db, atol=0.2)
    np.testing.assert_allclose(near.deviation_db, exact.deviation_db, rtol=0.01)


@pytest.mark.skipif(not CAMPUS.is_dir(), reason="the campus logs are not here")
def test_campus():
    """Days held out whole, every twentieth row of a real log: better than path loss."""
    file = CAMPUS / "honors.csv"
    rows = slice(None, None, 20)
    measurements = read_log(file, LogFormat(censored_column="near_floor")).take(rows)
    groups = read_groups(file, parse_groups("day"))[rows]
    learn = predictors_of(partial(fit_channel, station=Station((507.4, -66.6))))
    found = held_out_report(measurements, groups, groups, learn)
    for name in ("channel", "marginal"):
        assert found.scores[name].of_path_loss.value < 0.92
        assert 0.83 < found.scores[name].coverage[0.9].value < 0.97
