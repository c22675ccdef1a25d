"""Measurements of a signal, gathered along the way and shared between agents."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError


@dataclass(frozen=True, eq=False)
class Readings:
    """Means of measurements, each at one place.

    The mean of repeated measurements at one place and their number hold all that they tell.
    """

    positions_m: NDArray[np.float64]  # (k, 2) where they were taken
    signal: NDArray[np.float64]  # (k,) their means, in the signal's unit
    counts: NDArray[np.float64]  # (k,) how many measurements each is the mean of

    def __post_init__(self) -> None:
        count = len(self.signal)
        shapes = self.positions_m.shape, self.signal.shape, self.counts.shape
        if shapes != ((count, 2), (count,), (count,)):
            raise InputError(f"arrays of shapes {shapes} are no readings", key="readings")
        finite = np.isfinite(self.positions_m).all() and np.isfinite(self.signal).all()
        if not finite or not (self.counts >= 1.0).all():
            raise InputError("a reading is not finite, or of no measurement", key="readings")


def no_readings() -> Readings:
    """Return readings without any measurement."""
    return Readings(np.zeros((0, 2)), np.zeros(0), np.zeros(0))


def single_readings(positions_m: NDArray[np.float64], signal: NDArray[np.float64]) -> Readings:
    """Return measurements ``(k,)`` that were taken once at each of ``(k, 2)`` places."""
    return Readings(positions_m, signal, np.ones(len(signal)))


def pooled(logs: Iterable[Readings]) -> Readings:
    """Join readings, and average those that were taken at the very same place."""
    every = [no_readings(), *logs]
    positions = np.concatenate([log.positions_m for log in every])
    signal = np.concatenate([log.signal for log in every])
    counts = np.concatenate([log.counts for log in every])
    places, which = np.unique(positions, axis=0, return_inverse=True)
    total = np.bincount(which, counts, minlength=len(places))
    mean = np.bincount(which, counts * signal, minlength=len(places)) / np.maximum(total, 1.0)
    return Readings(places, mean, np.asarray(total, dtype=np.float64))
