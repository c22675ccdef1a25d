"""Held-out walks: predictors, scores against sums by hand, and a real log where it is there."""

import dataclasses

import numpy as np
import pytest
from refusals import refused
from scipy.stats import norm
from simulated_channel import simulated, subset

from planopt import InputError
from planopt.channel import (
    ChannelParameters,
    Measurements,
    Prediction,
    Station,
    fit_channel,
    held_out_report,
    predictors_of,
)
from planopt.channel.held_out import (
    deal,
    held_out_predictions,
    learn_path_loss,
    learn_plain_line,
    learn_plain_process,
    part_between,
)

PREDICTORS = ["channel", "marginal", "path_loss", "plain_line", "plain_process"]
CHANNEL = ChannelParameters(-30.0, 2.8, 6.0, 30.0, 2.0, Station((20.0, 35.0), 3.0))
PLAIN = ChannelParameters(-40.0, 3.0, 6.0, 40.0, 2.0, Station((50.0, 50.0), 10.0))


COUNT = 20_000


def score_of(spread=1.0, shift=0.0, limit_above=None):
    """The score of a faulty prediction of powers from N(-80, 4), some seen only as a limit."""
    power = np.random.default_rng(0).normal(-80.0, 4.0, COUNT)
    censored = np.zeros(COUNT, dtype=bool)
    if limit_above is not None:
        censored = power < limit_above
        power = np.where(censored, limit_above, power)
    measurements = Measurements(np.zeros((COUNT, 2)), power, censored)
    groups = np.arange(COUNT) % 100

    def predict(readings):
        count = len(readings)
        return Prediction(np.full(count, -80.0 + shift), np.full(count, 4.0 * spread))

    found = held_out_report(measurements, groups, groups % 2, lambda _: {"path_loss": predict})
    return found.scores["path_loss"]


@pytest.mark.parametrize("limit", [None, -84.0, -78.0])
def test_right_predictions(limit):
    """Every interval contains its level and the PIT is uniform, also with a floor."""
    found = score_of(limit_above=limit)
    for level, one in found.coverage.items():
        assert one.value == pytest.approx(level, abs=0.01)
        assert limit is not None or one.low < level < one.high
    np.testing.assert_allclose(found.pit_share, 0.05, atol=0.006)
    assert found.pit_share.sum() == pytest.approx(1.0)
    if limit is None:
        assert found.rmse_db.value == pytest.approx(4.0, rel=0.02)


@pytest.mark.parametrize("spread", [0.5, 2.0])
def test_wrong_deviation(spread):
    """A standard deviation wrong by a factor: coverage is 2 Phi(z factor) - 1."""
    for level, one in score_of(spread).coverage.items():
        expected = 2.0 * norm.cdf(norm.ppf(0.5 + 0.5 * level) * spread) - 1.0
        assert one.value == pytest.approx(expected, abs=0.01)


def test_wrong_mean():
    """A mean too high by a standard deviation puts the PIT low, and into the error."""
    found = score_of(shift=4.0)
    expected = norm.cdf(norm.ppf(np.linspace(0.0, 1.0, 21)) + 1.0)
    np.testing.assert_allclose(found.pit_share, np.diff(expected), atol=0.01)
    assert found.rmse_db.value == pytest.approx(np.sqrt(32.0), rel=0.02)


def test_parts_of_a_limit():
    """Shares by hand, the ends of the range included."""
    upper, censored = np.array([0.4]), np.array([True])
    assert part_between(upper, censored, 0.1, 0.2) == pytest.approx(0.25)
    assert part_between(upper, censored, 0.3, 1.0) == pytest.approx(0.25)
    nothing = np.array([0.0])
    assert part_between(nothing, censored, 0.0, 0.1) == 1.0
    assert part_between(nothing, censored, 0.1, 0.2) == 0.0
    exact = np.array([False, False])
    np.testing.assert_array_equal(part_between(np.array([1.0, 0.5]), exact, 0.95, 1.0), [1, 0])
    np.testing.assert_array_equal(part_between(np.array([0.1, 0.2]), exact, 0.1, 0.2), [1, 0])


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
    assert found.scores["path_loss"].of_path_loss.value == 1.0
    for ratio in (score.rmse_db, score.of_path_loss, *score.coverage.values()):
        assert ratio.low <= ratio.value <= ratio.high


def test_only_limits_teach_nothing():
    """Neither an error nor a predictor comes of upper limits alone."""
    measurements = Measurements(np.zeros((4, 2)), np.full(4, 9.0), np.ones(4, dtype=bool))
    groups = np.array([0, 0, 1, 1])
    with pytest.raises(InputError):
        held_out_report(measurements, groups, groups, lambda _: {"path_loss": constant(0.0)})
    with refused():
        learn_path_loss(measurements, CHANNEL.station)
    limits = dataclasses.replace(simulated(PLAIN, 2, 9, 90.0), censored=np.ones(9, dtype=bool))
    for learn in (learn_plain_process, lambda m: learn_plain_line(m, PLAIN.station)):
        with pytest.raises(InputError):
            learn(limits)


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


FLAT = dataclasses.replace(PLAIN, n_pl=0.0)


def test_line_is_a_polynomial_of_degree_one_in_the_logarithm():
    """NumPy's, of the exact powers alone; the mean where no slope can be estimated."""
    measurements = simulated(PLAIN, 0, 80, 200.0, 0.3)
    exact = measurements.take(np.flatnonzero(~measurements.censored))
    found = learn_plain_line(measurements, PLAIN.station)(measurements)
    distance = [
        np.hypot(np.linalg.norm(m.positions_m - PLAIN.station.position_m, axis=1), 10.0)
        for m in (exact, measurements)
    ]
    line, covariance = np.polyfit(np.log10(distance[0]), exact.power_dbm, 1, cov=True)
    np.testing.assert_allclose(found.mean_db, np.polyval(line, np.log10(distance[1])), rtol=1e-9)
    centred = np.log10(distance[0]) - np.log10(distance[0]).mean()
    np.testing.assert_allclose(found.deviation_db**2, covariance[0, 0] * centred @ centred)
    angle = np.linspace(0.0, 6.0, 12)
    places = PLAIN.station.position_m + 30.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    powers = -70.0 + np.arange(12.0)
    around = Measurements(places, powers, np.zeros(12, dtype=bool))
    found = learn_plain_line(around, PLAIN.station)(around)
    np.testing.assert_allclose(found.mean_db, powers.mean())


def test_process_predicts_what_it_should():
    """Without path loss it is nearly as good as the true covariance, and as sure as it may be."""
    both = simulated(FLAT, 5, 700, 200.0)
    known, asked = both.take(slice(400)), both.take(slice(400, None))
    found = learn_plain_process(known)(asked)
    true = PLAIN.shadow_std_db**2 * np.exp(
        -np.linalg.norm(both.positions_m[:, None] - both.positions_m, axis=2)
        / PLAIN.decorrelation_m
    )
    own = true[:400, :400] + PLAIN.multipath_std_db**2 * np.eye(400)
    mean = known.power_dbm.mean()
    oracle = mean + true[400:, :400] @ np.linalg.solve(own, known.power_dbm - mean)
    rmse = [np.sqrt(np.mean((asked.power_dbm - one) ** 2)) for one in (found.mean_db, oracle)]
    assert rmse[0] < 1.05 * rmse[1] < 0.7 * asked.power_dbm.std()
    inside = np.abs(asked.power_dbm - found.mean_db) < 1.96 * found.deviation_db
    assert 0.9 < inside.mean() < 0.99


def test_process_does_not_depend_on_the_order_of_rows(monkeypatch):
    """Not even where it rests on a draw of them; and upper limits play no part."""
    monkeypatch.setattr("planopt.channel.held_out.MOST_LIKELIHOOD", 50)
    monkeypatch.setattr("planopt.channel.held_out.MOST_CONDITIONED", 80)
    measurements = simulated(PLAIN, 7, 120, 200.0, 0.1)
    shuffled = subset(measurements, np.random.default_rng(1).permutation(120))
    exact = measurements.take(np.flatnonzero(~measurements.censored))
    first, *others = (
        learn_plain_process(one)(exact).mean_db for one in (measurements, shuffled, exact)
    )
    for other in others:
        np.testing.assert_array_equal(other, first)
