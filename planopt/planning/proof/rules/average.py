"""The rule on the average share of connected steps of the run so far and the plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planopt.planning.history import History
from planopt.planning.proof.rules.rule import Rule, connected_share
from planopt.problems.problem import Problem


@dataclass(frozen=True)
class Average(Rule):
    """The expected share of connected steps (equation 5.1) is at least p_min."""

    kind: ClassVar[str] = "average"
    method: ClassVar[str] = "mean"
    subject: ClassVar[str] = "the share of steps connected on average"

    def achieved(
        self, probability: NDArray[np.float64], history: History
    ) -> float | NDArray[np.float64]:
        """Return the expected share."""
        steps = history.steps + probability.shape[-1]
        return (history.connected_steps + probability.sum(axis=-1)) / steps

    def run_metrics(
        self, problem: Problem, connected: Sequence[NDArray[np.bool_]]
    ) -> dict[str, float]:
        """Return the share of connected steps."""
        return {"least_connected_share": min(connected_share(now) for now in connected)}
