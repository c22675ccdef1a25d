"""What a path is worth: the weighted sum of its terms, from all measurements.

This is what plans are compared by and what is reported. Solvers work with
:mod:`planopt.planning.worth.local_worth`, which is close to it and has derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.objectives.terms.term import Term
from planopt.planning.worth.rule_worth import slack_cost
from planopt.planning.worth.situation import Situation


@dataclass(frozen=True)
class PathWorth:
    """The worth of paths in one situation."""

    situation: Situation

    def __call__(self, path_m: NDArray[np.float64]) -> float:
        """Weighted sum of the terms for a path (N, 2), less the price of its slack."""
        return float(sum(self.by_term(path_m))) - slack_cost(self.situation, path_m)

    def by_term(self, path_m: NDArray[np.float64]) -> tuple[float, ...]:
        """What each term of the objective contributes, its weight included.

        Raises
        ------
        InputError
            A term has no finite value.
        """
        return tuple(self._contributed(number, path_m) for number in range(len(self._terms)))

    @property
    def _terms(self) -> tuple[Term, ...]:
        return self.situation.problem.terms

    def _contributed(self, number: int, path_m: NDArray[np.float64]) -> float:
        term = self._terms[number]
        try:
            return term.weight * term.value(self.situation, path_m)
        except InputError as error:
            if error.key is None or error.key.startswith("objective"):
                raise
            raise InputError(
                error.message,
                file=self.situation.problem.file,
                key=f"objective.terms[{number}].{error.key}",
                remedy=error.remedy,
            ) from None
