"""The distance that a robot drives until it is connected, along a given path (equation 3.10).

The prior field along a straight line, place by place: exact and fast.

With an exponential covariance the shadowing along a line is a Markov chain, so that the joint
probability of an event at every place so far is a one-dimensional integral carried forward. It
holds for the field before any measurement, on a line; elsewhere use
:mod:`planopt.channel.connection.joint_connectivity`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.connection.joint_connectivity import prefix_probabilities
from planopt.channel.joint import joint_prediction
from planopt.channel.parameters import ChannelParameters, regressors
from planopt.channel.places import leg_lengths_m, require_finite, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.short_repr import short_repr

REACH = 8.5
"""The grid spans this many deviations of shadowing on both sides; the rest weighs 1e-17."""

STEPS_PER_WIDTH = 2.0
"""Grid steps in the narrowest deviation, multipath's or that of one leg's innovation: equally
spaced sums over Gaussians are then exact to rounding."""

MAX_NODES = 4000

STRAIGHT = 1e-9
"""A path is straight while its length exceeds its chord by no more than this share."""


def line_prefix_probabilities(
    parameters: ChannelParameters,
    positions_m: NDArray[np.float64],  # (h, 2) on a straight line, without turning back
    threshold_dbm: float,
    event: Literal["connected", "disconnected"],
) -> NDArray[np.float64]:
    """P(event at places 1 .. k) for every k, before any measurement; ``(h,)``.

    J_0(s) = N(s; 0, xi^2) g_0(s), J_k(s) = g_k(s) int N(s; rho s', xi^2 (1 - rho^2)) J_{k-1}(s')
    ds', rho = exp(-leg / beta), g_k(s) = P(event at k | shadowing s) (equation 3.9); the integral
    of J_k is the value. Exact to about 1e-12.
    """
    places = require_places(positions_m)
    legs = leg_lengths_m(places)
    chord = float(np.hypot(*(places[-1] - places[0])))
    if float(legs.sum()) - chord > STRAIGHT * chord:
        raise InputError(
            "the path is not straight, or turns back",
            key="positions_m",
            remedy="use first_passage or joint_connectivity, which take any path",
        )
    mean = regressors(places, parameters.station) @ np.array([parameters.k_pl_db, parameters.n_pl])
    above = mean - require_finite(threshold_dbm, "threshold_dbm")
    carry = np.exp(-legs / parameters.decorrelation_m)
    innovation = parameters.shadow_std_db * np.sqrt(
        -np.expm1(-2.0 * legs / parameters.decorrelation_m)
    )
    shadowing, step = _grid(parameters, innovation)
    sign = 1.0 if event == "connected" else -1.0
    happens = np.asarray(
        ndtr(sign * (above[:, None] + shadowing) / parameters.multipath_std_db), dtype=np.float64
    )
    # Without shadowing the grid is the single value 0, whatever its deviation.
    weight = np.exp(-0.5 * (shadowing / (parameters.shadow_std_db or 1.0)) ** 2)
    mass = weight / weight.sum() * happens[0]
    probability = [mass.sum()]
    for rho, spread, now in zip(carry, innovation, happens[1:], strict=True):
        if spread > 0.0:
            distance = (shadowing[:, None] - rho * shadowing) / spread
            density = np.exp(-0.5 * distance * distance) / (math.sqrt(2.0 * math.pi) * spread)
            mass = step * (density @ mass)
        mass = mass * now
        probability.append(mass.sum())
    return np.array(probability)


def _grid(
    parameters: ChannelParameters, innovation_db: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Values of shadowing, equally spaced about zero, and their step."""
    if parameters.shadow_std_db == 0.0:
        return np.zeros(1), 1.0
    narrowest = min([parameters.multipath_std_db, *innovation_db[innovation_db > 0.0].tolist()])
    reach = REACH * parameters.shadow_std_db
    half = math.inf if narrowest == 0.0 else math.ceil(STEPS_PER_WIDTH * reach / narrowest)
    if 2 * half >= MAX_NODES:
        raise InputError(
            f"a leg or the multipath is too small for the integral along the line (narrowest "
            f"deviation {narrowest:.3g} dB)",
            key="positions_m",
            remedy="use first_passage or joint_connectivity, which take any path",
        )
    step = reach / half
    return step * np.arange(-half, half + 1.0), step


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
    return _passage(places, found.probability, found.error, disconnected_now)


def first_passage_on_line(
    parameters: ChannelParameters,
    positions_m: NDArray[np.float64],
    threshold_dbm: float,
    *,
    disconnected_now: bool = False,
) -> FirstPassage:
    """First connection along a straight line before any measurement: exact and fast.

    By the recursion of :func:`planopt.channel.connection.first_passage.line_prefix_probabilities`;
    arguments and errors as there and in :func:`first_passage`.
    """
    places = require_places(positions_m, 2)
    asked = places if disconnected_now else places[1:]
    found = line_prefix_probabilities(parameters, asked, threshold_dbm, "disconnected")
    return _passage(places, found, np.zeros_like(found), disconnected_now)


def _passage(
    places_m: NDArray[np.float64],
    probability: NDArray[np.float64],
    error: NDArray[np.float64],
    disconnected_now: bool,
) -> FirstPassage:
    """Put the certain start in front, or divide by the probability of what is given."""
    if not disconnected_now:
        probability = np.concatenate([[1.0], probability])
        error = np.concatenate([[0.0], error])
    elif probability[0] == 0.0:
        raise InputError(
            "the first place is certain to be connected: it cannot be given that it is not",
            key="disconnected_now",
        )
    travelled = np.concatenate([[0.0], np.cumsum(leg_lengths_m(places_m))])
    return FirstPassage(travelled, probability / probability[0], error / probability[0])
