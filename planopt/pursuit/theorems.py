"""Theorems about capture, and the inequalities that they rest on: plain data for all of pursuit."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Distances(Enum):
    """The distances that a guarantee is about."""

    STRAIGHT = "straight"
    PATHS = "paths"


class Theorem(Enum):
    """The theorem that a guarantee rests on."""

    LEMMA = "lemma"
    ANY_INSTANT = "any_instant"
    SAMPLED_DISTANCE = "sampled_distance"
    SNAPSHOTS = "snapshots"


@dataclass(frozen=True)
class Inequality:
    """``left < right``."""

    words: str  # What is compared
    left: float  # Both sides, in `unit` ("" for ratios)
    right: float
    unit: str = ""

    @property
    def holds(self) -> bool:
        """Return whether the inequality holds strictly."""
        return self.left < self.right

    @property
    def margin(self) -> float:
        """Return the right side less the left side; negative if the inequality fails."""
        return self.right - self.left

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        state = "holds" if self.holds else "fails"
        return (
            f"{self.words}: {self.left:.6g} < {self.right:.6g}{unit} "
            f"{state} by {abs(self.margin):.4g}{unit}"
        )
