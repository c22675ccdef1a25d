"""How well a belief knows the channel, over the workspace and about path loss."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.fields.truth import Truth, mean_power_dbm, true_power_dbm
from planopt.channel.mean_model import regressors
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.loop.log import ChannelLog
from planopt.planning.proof.predictions import search_prediction

LEAST_VARIANCE = 1e-30
"""Of a path loss that is known, so that its logarithms are numbers."""


def channel_errors_db(
    posteriors: Sequence[ChannelPosterior], truths: Sequence[Truth], places_m: NDArray[np.float64]
) -> tuple[float, float, float]:
    """RMS error, ANMSE and RMS error without multipath of predicted powers at `places_m` (n, 2).

    All in dB. ANMSE is 10 log10 of the mean of (error / true power)^2, both in dB ([GM11], section
    III-A2). The last is the error against path loss and shadowing: multipath, which nobody can
    predict, makes all maps look alike. Means over the powers of all stations.
    """
    power = np.stack([true_power_dbm(truth, places_m) for truth in truths])
    predicted = [search_prediction(posterior, places_m).mean_db for posterior in posteriors]
    error = np.stack(predicted) - power
    rms = float(np.sqrt((error**2).mean()))
    shadowed = np.stack([mean_power_dbm(truth, places_m) for truth in truths])
    without = float(np.sqrt(((np.stack(predicted) - shadowed) ** 2).mean()))
    # A true power of 0 dBm, where the ratio is infinite, is a chance of nothing.
    ratio = error / np.where(power == 0.0, np.finfo(float).tiny, power)
    return rms, float(10.0 * np.log10((ratio**2).mean())), without


def theta_variance_db(posteriors: Sequence[ChannelPosterior]) -> float:
    """Return 10 log10 tr M / |theta|^2 (Fig. 2 of [GM11]), each summed over the stations."""
    spread = sum(float(np.trace(posterior.theta_covariance)) for posterior in posteriors)
    size = sum(float(posterior.theta @ posterior.theta) for posterior in posteriors)
    return float(10.0 * np.log10(max(spread / size, LEAST_VARIANCE)))


def log_det_m(posteriors: Sequence[ChannelPosterior]) -> float:
    """Log det M in nats, summed over the stations."""
    least = 2.0 * float(np.log(LEAST_VARIANCE))
    found = (float(np.linalg.slogdet(each.theta_covariance)[1]) for each in posteriors)
    return sum(max(each, least) for each in found)


def path_loss_variance_db2(
    posteriors: Sequence[ChannelPosterior], places_m: NDArray[np.float64]
) -> float:
    """Mean over places (n, 2) and stations of gamma^T M gamma: the variance of path loss, dB^2."""
    rows = [regressors(places_m, each.parameters.station) for each in posteriors]
    variances = [
        np.einsum("ni,ij,nj->n", row, each.theta_covariance, row)
        for row, each in zip(rows, posteriors, strict=True)
    ]
    return float(np.mean(variances))


def channel_row(
    posteriors: Sequence[ChannelPosterior], truths: Sequence[Truth], places_m: NDArray[np.float64]
) -> tuple[float, ...]:
    """Return a row of the log, in the order of :class:`ChannelLog`."""
    rms, anmse, without = channel_errors_db(posteriors, truths, places_m)
    return (
        rms,
        anmse,
        theta_variance_db(posteriors),
        log_det_m(posteriors),
        without,
        path_loss_variance_db2(posteriors, places_m),
    )


def channel_log(rows: Sequence[tuple[float, ...]]) -> ChannelLog:
    """The log of rows of :func:`channel_row`."""
    return ChannelLog(*np.asarray(rows, dtype=np.float64).T)
