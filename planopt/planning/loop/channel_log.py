"""How well a belief knows the channel, over the workspace and about path loss."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.fields.truth import Truth, true_power_dbm
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.team.team_run import ChannelLog


def channel_errors_db(
    posterior: ChannelPosterior, truth: Truth, places_m: NDArray[np.float64]
) -> tuple[float, float]:
    """RMS error in dB and ANMSE in dB of the predicted power at `places_m` (n, 2).

    ANMSE is 10 log10 of the mean of (error / true power)^2, both in dB (seed, section III-A2).
    """
    power = true_power_dbm(truth, places_m)
    error = search_prediction(posterior, places_m).mean_db - power
    rms = float(np.sqrt((error**2).mean()))
    # A true power of 0 dBm, where the ratio is infinite, is a chance of nothing.
    ratio = error / np.where(power == 0.0, np.finfo(float).tiny, power)
    return rms, float(10.0 * np.log10((ratio**2).mean()))


def theta_variance_db(posterior: ChannelPosterior) -> float:
    """10 log10 tr M / |theta|^2 (the seed's Fig. 2)."""
    spread = float(np.trace(posterior.theta_covariance))
    return float(10.0 * np.log10(spread / float(posterior.theta @ posterior.theta)))


def channel_row(
    posterior: ChannelPosterior, truth: Truth, places_m: NDArray[np.float64]
) -> tuple[float, float, float]:
    """A row of the log: RMS, ANMSE and path loss variance, all in dB."""
    return *channel_errors_db(posterior, truth, places_m), theta_variance_db(posterior)


def channel_log(rows: Sequence[tuple[float, float, float]]) -> ChannelLog:
    """The log of rows of RMS, ANMSE and path loss variance."""
    rms, anmse, theta = np.asarray(rows, dtype=np.float64).T
    return ChannelLog(rms, anmse, theta)
