"""Data that waits in a buffer and is sent while there is connection."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError


@dataclass(frozen=True)
class Traffic:
    """Data to be sent, as a fluid.

    Attributes
    ----------
    link_bps
        Rate while connected, above 0.
    waiting_bits
        In the buffer at the start.
    source_bps
        Rate at which more arrives.
    buffer_bits
        What the buffer holds; what arrives beyond is lost.

    Raises
    ------
    InputError
        A number is negative or NaN, or more waits than the buffer holds.
    """

    link_bps: float
    waiting_bits: float = 0.0
    source_bps: float = 0.0
    buffer_bits: float = math.inf

    def __post_init__(self) -> None:
        if not 0.0 < self.link_bps < math.inf:
            raise InputError(f"{self.link_bps!r} is no rate", key="link_bps")
        if not 0.0 <= self.source_bps < math.inf:
            raise InputError(f"{self.source_bps!r} is no rate", key="source_bps")
        if not 0.0 <= self.waiting_bits < math.inf or not self.waiting_bits <= self.buffer_bits:
            raise InputError(
                f"{self.waiting_bits!r} bits cannot wait in a buffer of {self.buffer_bits!r}",
                key="waiting_bits",
            )


def sent_and_lost(
    durations_s: NDArray[np.float64], connected: NDArray[np.bool_], traffic: Traffic
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Bits delivered, lost, and left in the buffer, exactly for a fluid; three of ``(count,)``.

    On a leg the rates are constant, so the buffer either fills or empties all along: only the
    leg's end must be looked at.

    Parameters
    ----------
    durations_s
        ``(h - 1,)`` of the legs.
    connected
        ``(count, h)`` at each place; a leg has the state of the place it ends at.
    traffic
        Rates and buffer.
    """
    waiting = np.full(len(connected), traffic.waiting_bits)
    delivered = np.zeros(len(connected))
    lost = np.zeros(len(connected))
    for duration, now in zip(durations_s, connected[:, 1:].T, strict=True):
        offered = waiting + traffic.source_bps * duration
        sent = np.where(now, np.minimum(traffic.link_bps * duration, offered), 0.0)
        waiting = np.minimum(offered - sent, traffic.buffer_bits)
        delivered += sent
        lost += offered - sent - waiting
    return delivered, lost, waiting
