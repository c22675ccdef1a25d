"""Theorems about capture and their inequalities, as plain data for the whole package."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Distances(Enum):
    """Distances to which a guarantee refers."""

    STRAIGHT = "straight"
    PATHS = "paths"


class Theorem(Enum):
    """Theorem on which a guarantee is based."""

    LEMMA = "lemma"
    ANY_INSTANT = "any_instant"
    SAMPLED_DISTANCE = "sampled_distance"
    SNAPSHOTS = "snapshots"


@dataclass(frozen=True)
class Inequality:
    """``left < right``."""

    words: str  # Description of the inequality
    left: float  # Both sides, in `unit` ("" for ratios)
    right: float
    unit: str = ""

    @property
    def holds(self) -> bool:
        """Return whether the inequality holds strictly."""
        return self.left < self.right

    @property
    def margin(self) -> float:
        """Return the right side minus the left side; negative if the inequality fails."""
        return self.right - self.left

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        state = "holds" if self.holds else "fails"
        return (
            f"{self.words}: {self.left:.6g} < {self.right:.6g}{unit} "
            f"{state} by {abs(self.margin):.4g}{unit}"
        )
