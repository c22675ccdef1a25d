"""The parameters of the channel model: path loss, shadowing and multipath."""

from __future__ import annotations

import math
from dataclasses import dataclass

from planopt.channel.places import MAX_COORDINATE_M
from planopt.errors import InputError


@dataclass(frozen=True)
class Station:
    """The fixed base station; an access point or gateway as well.

    Attributes
    ----------
    position_m
        ``(x, y)`` in metres.
    height_m
        Height of its antenna above the robots' antennas; distances are three-dimensional.

    Raises
    ------
    InputError
        A coordinate is not finite, or beyond :data:`planopt.channel.places.MAX_COORDINATE_M`.
    """

    position_m: tuple[float, float]
    height_m: float = 0.0

    def __post_init__(self) -> None:
        for value in (*self.position_m, self.height_m):
            if not abs(value) <= MAX_COORDINATE_M:
                raise InputError(
                    f"{value!r} m is no coordinate of a station",
                    key="station",
                    remedy=f"give metres within {MAX_COORDINATE_M:g}",
                )


@dataclass(frozen=True)
class ChannelParameters:
    """Parameters of the received power in dBm (equations 1.1 and 1.2).

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

    Raises
    ------
    InputError
        A number is NaN, or infinite but for the last; a deviation is negative; or a distance or
        time that something is forgotten over is not positive.
    """

    k_pl_db: float
    n_pl: float
    shadow_std_db: float
    decorrelation_m: float
    multipath_std_db: float
    station: Station
    forgetting_s: float = math.inf

    def __post_init__(self) -> None:
        for name in ("k_pl_db", "n_pl", "shadow_std_db", "decorrelation_m", "multipath_std_db"):
            if not math.isfinite(getattr(self, name)):
                raise InputError(f"{getattr(self, name)!r} is not finite", key=name)
        for name in ("shadow_std_db", "multipath_std_db"):
            if getattr(self, name) < 0.0:
                raise InputError(f"{getattr(self, name)!r} dB is no deviation", key=name)
        for name in ("decorrelation_m", "forgetting_s"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{getattr(self, name)!r} is not above 0", key=name)
