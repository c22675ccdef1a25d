"""What a path achieves of the rule of connectivity that it must keep."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from planopt.problems.rule_kinds import rule_kind


@dataclass(frozen=True)
class RuleResult:
    """What was asked over a whole plan, and what the path achieves.

    Attributes
    ----------
    connectivity
        The rule.
    achieved, asked
        Its value, and the bound: a least one, for ``outage`` a greatest one.
    unit
        ``probability``, ``m``, ``s``, ``Mbit`` or ``steps``.
    method
        How the value was found.
    slack_db
        By how many dB the threshold would have to be lower for the path to keep the rule, as far
        as slack is allowed; of single steps, the most.
    """

    connectivity: str
    achieved: float
    asked: float
    unit: str
    method: str
    slack_db: float = 0.0

    @property
    def missing(self) -> float:
        """By how much the bound is missed, in its unit; negative where there is some to spare."""
        short = self.asked - self.achieved
        return -short if rule_kind(self.connectivity).greatest else short

    @property
    def words(self) -> str:
        """One line for people."""
        unit = "" if self.unit == "probability" else f" {self.unit}"
        return (
            f"connectivity ({self.connectivity.replace('_', ' ')}): {self.achieved:.4g}{unit}, "
            f"{self.asked:.4g}{unit} asked ({self.method}); slack {self.slack_db:.2f} dB"
        )


def worst_result(results: Iterable[RuleResult | None]) -> RuleResult | None:
    """The one with the most slack, or the least to spare; None where there is none."""
    there = [result for result in results if result is not None]
    return max(there, key=lambda result: (result.slack_db, result.missing), default=None)
