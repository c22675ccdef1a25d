"""The distance that a robot drives until it is connected, along a given path (equation 3.10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.channel.connection.joint_connectivity import prefix_probabilities
from planopt.channel.joint import joint_prediction
from planopt.channel.places import leg_lengths_m, require_finite, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class FirstPassage:
    """The first connection along a path q_0 .. q_h; the robot stands at q_0.

    Attributes
    ----------
    travelled_m
        ``(h + 1,)`` length of the path up to each place; the first is 0.
    not_connected
        ``(h + 1,)`` pi_k, the probability of no connection at q_1 .. q_k; the first is 1.
    not_connected_error
        ``(h + 1,)`` three standard errors; zero where exact.
    """

    travelled_m: NDArray[np.float64]
    not_connected: NDArray[np.float64]
    not_connected_error: NDArray[np.float64]

    __repr__ = short_repr

    @property
    def connected_by(self) -> NDArray[np.float64]:
        """``(h + 1,)`` distribution function of the first passage, 1 - pi_k."""
        return 1.0 - self.not_connected

    @property
    def expected_distance_m(self) -> float:
        """E[D] = sum_k leg_{k+1} pi_k: driven until connected, or to the path's end."""
        return float(np.diff(self.travelled_m) @ self.not_connected[:-1])

    @property
    def expected_distance_error_m(self) -> float:
        """Error of :attr:`expected_distance_m` if those of pi_k all went one way."""
        return float(np.diff(self.travelled_m) @ self.not_connected_error[:-1])


def first_passage(
    posterior: ChannelPosterior,
    positions_m: ArrayLike,
    threshold_dbm: float,
    generator: np.random.Generator,
    *,
    disconnected_now: bool = False,
    tolerance: float = 1e-4,
) -> FirstPassage:
    """Return the law of the first connection along a path, given measurements (equation 3.10).

    pi_k = P(power < threshold at q_1 .. q_k) by the multivariate normal distribution. Chances at
    the places are not taken as independent, which would promise too much.

    Parameters
    ----------
    posterior
        The channel given measurements.
    positions_m
        ``(h + 1, 2)`` metres, h >= 1, where the robot stands first.
    threshold_dbm
        Power from which on a place is connected.
    generator
        Source of randomness of the integration.
    disconnected_now
        Condition on no connection at the first place too. False where that is already among the
        measurements, or where the first place does not matter.
    tolerance
        Accuracy of pi_k that is tried for; the one reached is in the result.

    Raises
    ------
    InputError
        `positions_m` is no path, the threshold is not finite, or `disconnected_now` is
        impossible.
    """
    places = require_places(positions_m, 2)
    asked = places if disconnected_now else places[1:]
    prediction = joint_prediction(posterior, asked)
    below = require_finite(threshold_dbm, "threshold_dbm") - prediction.mean_db
    found = prefix_probabilities(below, prediction.covariance_db2, generator, tolerance)
    probability, error = found.probability, found.error
    if not disconnected_now:
        probability, error = np.append(1.0, probability), np.append(0.0, error)
    elif probability[0] == 0.0:
        raise InputError(
            "the first place is certain to be connected: it cannot be given that it is not",
            key="disconnected_now",
        )
    travelled = np.append(0.0, np.cumsum(leg_lengths_m(places)))
    return FirstPassage(travelled, probability / probability[0], error / probability[0])
