"""What measurements say of predicted probabilities of connection, and the law that follows.

Each outcome compares a prediction with what was then measured: was the power at least the
threshold? The first measurements are predicted from all others (leave one out); each later one from
those before it, as the robot that took it did. The calibrated law
(:mod:`planopt.channel.connection.connection_law`) is fitted to these outcomes and fitted again with
each measurement.

The law assumes that outcomes at places to come are like those at measured ones of equal score. It
corrects the shape of the predictive law, and what driving selects among places, as far as the
outcomes show it; it does not know that some streets are worse than others.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.connection_law import LEAST_DEVIATION_DB, ConnectionLaw
from planopt.channel.connection.platt_scaling import fit_connection_law
from planopt.channel.leave_one_out import leave_one_out
from planopt.channel.measurements import Measurements
from planopt.channel.prediction import Prediction

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior

LEFT_OUT = 500
"""At most so many of the first measurements are left out in turn, evenly among them."""

LEFT_OUT_WEIGHT = 0.5
"""An outcome at a first measurement counts so much of one on the way: there, measurements are
nearer, and places are those that plans prefer. Over driven runs on two ray-traced maps and four
drawn channels 0.3, 0.5 and 1 came within 0.003 of each other in the logarithmic score of a step."""

REMEMBERED = 500
"""At most so many outcomes on the way count, the latest."""


@dataclass(frozen=True, eq=False)
class ConnectionOutcomes:
    """Outcomes of predictions of one station's connection, and the law fitted to them.

    Attributes
    ----------
    threshold_dbm
        From which power on a place is connected.
    scores
        ``(n,)`` (mean - threshold) / deviation of each prediction.
    connected
        ``(n,)`` whether the power was at least the threshold.
    left_out
        How many of them, the first ones, are at first measurements.
    law
        Fitted to the outcomes.
    """

    threshold_dbm: float
    scores: NDArray[np.float64] = field(repr=False)
    connected: NDArray[np.bool_] = field(repr=False)
    left_out: int
    law: ConnectionLaw


def calibrate_posterior(posterior: ChannelPosterior, threshold_dbm: float) -> ChannelPosterior:
    """Begin the calibration of a posterior from its measurements, each left out in turn.

    Parameters
    ----------
    posterior
        From the first measurements; theta known or estimated by generalised least squares.
    threshold_dbm
        From which power on a place is connected.

    Returns
    -------
    ChannelPosterior
        The same with outcomes. Posteriors that extend it go on with them.
    """
    count = len(posterior.measurements)
    chosen = np.unique(np.linspace(0, count - 1, min(count, LEFT_OUT)).round().astype(np.intp))
    begun = ConnectionOutcomes(
        threshold_dbm, np.zeros(0), np.zeros(0, dtype=bool), 0, ConnectionLaw()
    )
    if count > 1:
        taken = posterior.measurements.take(chosen)
        scores, connected = _compared(leave_one_out(posterior, chosen), taken, threshold_dbm)
        begun = replace(begun, scores=scores, connected=connected, left_out=len(scores))
    return replace(posterior, outcomes=_fitted(begun))


def add_outcomes(
    outcomes: ConnectionOutcomes, prediction: Prediction, measured: Measurements
) -> ConnectionOutcomes:
    """Count what was measured on the way, and fit the law again.

    Parameters
    ----------
    outcomes
        So far.
    prediction
        Of the powers of `measured`, made without them.
    measured
        n measurements.
    """
    scores, connected = _compared(prediction, measured, outcomes.threshold_dbm)
    first = outcomes.left_out
    latest = max(first, len(outcomes.scores) + len(scores) - REMEMBERED)
    kept = np.r_[:first, latest : len(outcomes.scores)]
    return _fitted(
        replace(
            outcomes,
            scores=np.concatenate([outcomes.scores[kept], scores]),
            connected=np.concatenate([outcomes.connected[kept], connected]),
        )
    )


def _fitted(outcomes: ConnectionOutcomes) -> ConnectionOutcomes:
    """Fit the law to the outcomes."""
    weights = np.ones(len(outcomes.scores))
    weights[: outcomes.left_out] = LEFT_OUT_WEIGHT
    law = fit_connection_law(outcomes.scores, outcomes.connected, weights)
    return replace(outcomes, law=law)


def _compared(
    prediction: Prediction, measured: Measurements, threshold_dbm: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Scores and outcomes, where a censored measurement tells which it was."""
    known = ~measured.censored | (measured.power_dbm < threshold_dbm)
    deviation = np.maximum(prediction.deviation_db, LEAST_DEVIATION_DB)
    scores = (prediction.mean_db - threshold_dbm) / deviation
    return scores[known], (measured.power_dbm >= threshold_dbm)[known]
