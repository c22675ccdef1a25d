"""Packets that have estimates: the first after an outage tells all that its sender measured.

In a draw of the channel (:mod:`planopt.objectives.tracking_scenarios`) what robot i measured at
step s is known at step k unless all its packets from s to k are lost, so that the filter of step k
counts

    u_{s|k} = 1/2 sum_i tr Lambda_{i,s}^-1 (1 - prod_{j = s..k} (1 - p_{i,j})),    s <= k,

from the last step on that the station knows all of (equation 4.25). With p in {0, 1} this is the
station's own filter. A robot that stands at the end of its path has no further try there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr


@dataclass(frozen=True, eq=False)
class Held:
    """The robots' measurements that the station does not know yet."""

    # (4, 4) J of the station M steps ago, from when on something is missing
    information: NDArray[np.float64]
    known: NDArray[np.float64]  # (M,) information per axis that it has of the steps since, per m^2
    # (paths, M) the same of what the robot of each path holds and the station does not
    sent: NDArray[np.float64]

    @property
    def steps(self) -> int:
        """M."""
        return len(self.known)


def counting(held: int, stage: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the packets that tell of step s at step k: ``(K, held + K, K)`` of 0 and 1."""
    # Shapes: stage (K,).
    count = len(stage)
    k, s, place = np.ogrid[:count, : held + count, :count]
    first = stage[np.maximum(s - held, 0)]
    return np.where((s <= held + k) & (first <= place) & (place <= stage[k]), 1.0, 0.0)


def missing(log_lost: NDArray[np.float64], which: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the chance ``(..., K, M + K)`` that step s is unknown at step k, of logs (..., K)."""
    count, told, _ = which.shape
    found = np.exp(log_lost @ which.reshape(count * told, -1).T)
    return found.reshape(*log_lost.shape[:-1], count, told)


def told_of(
    missed: NDArray[np.float64], sensing: NDArray[np.float64], sent: NDArray[np.float64]
) -> NDArray[np.float64]:
    """u_{s|k} of one robot, ``(..., K, M + K)``; zero for steps after k."""
    # Shapes: sensing (..., K); sent (M,).
    past = np.broadcast_to(sent, (*sensing.shape[:-1], len(sent)))
    each = np.concatenate([past, 0.5 * sensing], axis=-1)
    count, held = sensing.shape[-1], len(sent)
    earlier = np.tri(count, held + count, held)
    return earlier * (1.0 - missed) * each[..., None, :]


def log_lost(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the logarithm of the chance that a packet is lost, for smoothed scores."""
    return np.asarray(log_ndtr(-scores), dtype=np.float64)
