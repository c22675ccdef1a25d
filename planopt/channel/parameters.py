"""The parameters of the channel model: path loss, shadowing and multipath."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Station:
    """The fixed station (the seed's base station at q_b).

    Attributes
    ----------
    position_m
        ``(x, y)`` in metres.
    height_m
        Height of its antenna above the robots' antennas; distances are three-dimensional.
    """

    position_m: tuple[float, float]
    height_m: float = 0.0


@dataclass(frozen=True)
class ChannelParameters:
    """Parameters of the received power in dBm (seed, section II).

    ``power(q) = k_pl_db - 10 n_pl log10 d(q) + shadowing(q) + multipath(q)``, with shadowing of
    covariance ``shadow_std_db**2 exp(-distance / decorrelation_m)`` and multipath white with
    deviation ``multipath_std_db``.

    Attributes
    ----------
    k_pl_db
        K_PL: received power at one metre, in dBm; transmit power is in it.
    n_pl
        n_PL: path loss exponent.
    shadow_std_db
        xi: deviation of shadowing.
    decorrelation_m
        beta: decorrelation distance.
    multipath_std_db
        omega: deviation of multipath fading in dB.
    station
        The fixed station.
    forgetting_s
        Time over which shadowing forgets: its covariance also has the factor ``exp(-age /
        forgetting_s)``. Infinite for a channel that does not drift.
    """

    k_pl_db: float
    n_pl: float
    shadow_std_db: float
    decorrelation_m: float
    multipath_std_db: float
    station: Station
    forgetting_s: float = math.inf
