"""What not knowing the channel costs: the study's arithmetic, and its numbers in small."""

from functools import partial

import numpy as np
import pytest

from planopt.channel.joint import predict_readings
from planopt.channel.multipath.multipath_models import Rician
from planopt.channel.posterior import condition
from planopt.channel.prediction import Prediction
from planopt.channel.validation.held_out import learn_path_loss
from planopt.studies.estimation import (
    EstimationCase,
    estimation_study,
    published_case,
)

SMALL = 40
"""Channels; `docs/measure_estimation.py` takes 400."""

CASES = [published_case("fig3", 50.0), published_case("fig4", 100.0)]


def rows_of(*arguments, **options):
    """Rows by learner."""
    return {row.learner: row for row in estimation_study(*arguments, **options)}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_at_102_measurements(case):
    """Maps all but as good as with the true parameters, and intervals that hold."""
    rows = rows_of(case, 102, SMALL)
    for learner in ("reml", "marginal"):
        assert rows[learner].of_oracle.value <= 1.02
        assert 0.93 <= rows[learner].coverage.value <= 0.97
    assert rows["oracle"].of_oracle.value == 1.0


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_at_16_measurements(case):
    """With the covariance marginalised at least 92 % are inside."""
    rows = rows_of(case, 16, SMALL)
    assert rows["marginal"].coverage.value >= 0.92
    assert rows["marginal"].coverage.value > rows["reml"].coverage.value


def test_path_loss_alone_is_worse():
    """What a learner without shadowing loses is seen, more so without multipath."""
    rows = rows_of(CASES[1], 102, 10, learners={"line": learn_path_loss})
    assert rows["line"].of_oracle.low > 1.2
    assert rows["line"].latent_of_oracle.value > rows["line"].of_oracle.value


def test_the_oracle_as_learner_and_an_error_of_3_db():
    """A learner with the true parameters ties; 3 dB of error add 9 to the squares."""
    case = CASES[0]

    def truth(known, station):
        assert station == case.channel.station
        posterior = condition(case.channel, known, theta="known")
        return partial(predict_readings, posterior)

    def biased(error_db):
        def learn(known, station):
            def predict(readings):
                right = truth(known, station)(readings)
                return Prediction(right.mean_db + error_db, right.deviation_db)

            return predict

        return learn

    learners = {"truth": truth, "above": biased(3.0), "below": biased(-3.0)}
    rows = rows_of(case, 30, 5, learners=learners)
    assert rows["truth"].of_oracle.value == rows["truth"].latent_of_oracle.value == 1.0
    assert rows["truth"].coverage == rows["oracle"].coverage
    squares = {name: row.rmse_db.value**2 for name, row in rows.items()}
    assert 0.5 * (squares["above"] + squares["below"]) - squares["oracle"] == pytest.approx(9.0)


def test_channels_are_the_same_whatever_their_number():
    """Channel k does not depend on how many are drawn, and no two are alike."""
    seen = []

    def learn(known, station):
        seen.append(known.power_dbm)
        return learn_path_loss(known, station)

    for channels in (2, 4):
        estimation_study(CASES[0], 12, channels, 7, {"line": learn})
    np.testing.assert_array_equal(seen[:2], seen[2:4])
    assert len({tuple(powers) for powers in seen}) == 4


def test_law_of_multipath():
    """Rician fading of the same deviation gives other powers and about the same errors."""
    gaussian = CASES[0]
    rician = EstimationCase("fig3", gaussian.channel, gaussian.side_m, Rician(10.0))
    one, other = (rows_of(case, 50, 10, learners={})["oracle"] for case in (gaussian, rician))
    assert one.rmse_db != other.rmse_db
    assert other.rmse_db.value == pytest.approx(one.rmse_db.value, rel=0.1)
