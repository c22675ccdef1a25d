"""Outcomes of predicted connection: what is compared, what is remembered, and what follows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import expit

from planopt.channel.connection.connection_law import (
    LEFT_OUT,
    LEFT_OUT_WEIGHT,
    REMEMBERED,
    calibrate_posterior,
    fit_connection_law,
)
from planopt.channel.fields.field import shadow_field_db
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station, regressors
from planopt.channel.posterior import condition

STATION = Station((60.0, 60.0), 5.0)
PARAMETERS = ChannelParameters(-30.0, 3.0, 6.0, 15.0, 3.0, STATION)
THRESHOLD_DBM = -80.0


def channel(seed: int, inflated: float = 1.0) -> Measurements:
    """All 3,600 cells of a drawn field in random order, deviations `inflated` times the model's."""
    generator = np.random.default_rng(seed)
    cells = np.stack(np.meshgrid(np.arange(1.0, 120.0, 2.0), np.arange(1.0, 120.0, 2.0)), axis=-1)
    places = cells.reshape(-1, 2)
    power = regressors(places, STATION) @ [PARAMETERS.k_pl_db, PARAMETERS.n_pl]
    field = shadow_field_db(cells.shape[:2], 2.0, 6.0 * inflated, 15.0, generator)
    power = power + field.values_db.ravel() + 3.0 * inflated * generator.standard_normal(len(power))
    order = generator.permutation(len(places))
    return Measurements(places[order], power[order], np.zeros(len(order), dtype=bool))


def first(data: Measurements, count: int = 200):
    """A calibrated posterior from the first `count`."""
    return calibrate_posterior(condition(PARAMETERS, data.take(slice(count))), THRESHOLD_DBM)


def test_leaves_each_first_measurement_out():
    """Scores are those of conditioning again without it; mean and deviation are as they were."""
    data = channel(0)
    posterior = first(data, 60)
    outcomes = posterior.outcomes
    assert outcomes.left_out == len(outcomes.scores) == 60
    for row in (0, 31, 59):
        rest = condition(PARAMETERS, data.take(np.flatnonzero(np.arange(60) != row)))
        power = rest.predict(data.positions_m[row : row + 1])
        score = (power.mean_db[0] - THRESHOLD_DBM) / power.deviation_db[0]
        assert outcomes.scores[row] == pytest.approx(score, abs=1e-9)
        assert outcomes.connected[row] == (data.power_dbm[row] >= THRESHOLD_DBM)
    plain = condition(PARAMETERS, data.take(slice(60))).predict(data.positions_m[60:70])
    np.testing.assert_array_equal(posterior.predict(data.positions_m[60:70]).mean_db, plain.mean_db)


def test_compares_later_ones_with_what_was_known_before():
    """One by one, and the law is fitted again with the first ones at their weight."""
    data = channel(1)
    posterior = first(data, 50)
    for row in range(50, 60):
        power = posterior.predict(data.positions_m[row : row + 1])
        score = (power.mean_db[0] - THRESHOLD_DBM) / power.deviation_db[0]
        posterior = posterior.extend(data.take(slice(row, row + 1)))
        assert posterior.outcomes.scores[row] == pytest.approx(score, abs=1e-9)
    outcomes = posterior.outcomes
    weights = np.r_[np.full(50, LEFT_OUT_WEIGHT), np.ones(10)]
    assert outcomes.law == fit_connection_law(outcomes.scores, outcomes.connected, weights)
    assert outcomes.left_out == 50 and len(outcomes.connected) == 60


def test_a_censored_one_counts_where_it_tells():
    """At most -85 dBm is no connection at -80; at most -70 dBm may be either."""
    data = channel(2).take(slice(30))
    weak, strong = data.power_dbm.copy(), data.power_dbm.copy()
    weak[0], strong[0] = -85.0, -70.0
    for power, counted in ((weak, 30), (strong, 29)):
        censored = Measurements(data.positions_m, power, np.arange(30) == 0)
        outcomes = first(censored, 30).outcomes
        assert len(outcomes.scores) == counted
        assert not outcomes.connected[0] or counted == 29


def test_remembers_so_many():
    """The first ones stay, of the later ones the latest."""
    data = channel(3)
    posterior = first(data, LEFT_OUT + 40)
    assert posterior.outcomes.left_out == LEFT_OUT
    start, more = LEFT_OUT + 40, REMEMBERED + 30
    grown = posterior.extend(data.take(slice(start, start + more)))
    outcomes = grown.outcomes
    assert len(outcomes.scores) == LEFT_OUT + more
    again = grown.extend(data.take(slice(start + more, start + more + 1))).outcomes
    assert len(again.scores) == LEFT_OUT + REMEMBERED
    np.testing.assert_array_equal(again.scores[:LEFT_OUT], outcomes.scores[:LEFT_OUT])
    np.testing.assert_array_equal(again.scores[-3:-1], outcomes.scores[-2:])


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_to_compare_is_the_neutral_law(count):
    """No measurement, or one, has no other to predict it."""
    posterior = first(channel(4), count)
    assert posterior.outcomes.law == fit_connection_law(np.zeros(0), np.zeros(0, bool), np.zeros(0))
    grown = posterior.extend(channel(4).take(slice(5, 6)))
    assert len(grown.outcomes.scores) == 1


def log_score(posterior, data: Measurements, *, calibrated: bool) -> float:
    """Mean logarithmic score of P(connected) at unseen places; higher is better."""
    power = posterior.predict(data.positions_m)
    score = (power.mean_db - THRESHOLD_DBM) / power.deviation_db
    law = (
        posterior.outcomes.law
        if calibrated
        else replace(posterior.outcomes.law, intercept=0.0, slope=1.702)
    )
    chance = expit(law.intercept + law.slope * score)
    connected = data.power_dbm >= THRESHOLD_DBM
    return float(np.log(np.where(connected, chance, 1.0 - chance)).mean())


def test_corrects_a_model_that_is_too_sure():
    """Deviations half of what they are: the law flattens, and predicts unseen places better."""
    gains, slopes = [], []
    for seed in range(10, 16):
        data = channel(seed, inflated=2.0)
        posterior, unseen = first(data, 300), data.take(slice(1000, 3000))
        gains.append(
            log_score(posterior, unseen, calibrated=True)
            - log_score(posterior, unseen, calibrated=False)
        )
        slopes.append(posterior.outcomes.law.slope)
    assert np.mean(slopes) == pytest.approx(0.5 * 1.702, rel=0.25)
    assert min(gains) > 0.0


def test_leaves_a_model_that_is_right_nearly_as_it_is():
    """Over ten channels the law stays near the neutral one, and costs next to nothing."""
    laws, costs = [], []
    for seed in range(20, 30):
        data = channel(seed)
        posterior, unseen = first(data, 300), data.take(slice(1000, 3000))
        laws.append((posterior.outcomes.law.intercept, posterior.outcomes.law.slope))
        costs.append(
            log_score(posterior, unseen, calibrated=False)
            - log_score(posterior, unseen, calibrated=True)
        )
    intercept, slope = np.mean(laws, axis=0)
    assert abs(intercept) < 0.3 and abs(slope - 1.702) < 0.35
    assert np.mean(costs) < 0.005
