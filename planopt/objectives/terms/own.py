"""Terms from outside planopt whose value is a CasADi expression of the path."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.batch_derivatives import PathDerivatives
from planopt.objectives.expression_casadi import PathSymbols, program_of
from planopt.objectives.terms.context import NearPath, Paths, StepContext
from planopt.objectives.terms.expression import CasadiTerm
from planopt.objectives.terms.term import Term, TermSetting

FEW_STEPS = 2
"""Steps of the expression that is looked through for the names that it reads."""


@dataclass(frozen=True)
class OwnTerm(Term):
    """Base class of a term of one's own: a frozen dataclass with a ``kind`` and an expression.

    The fields of a subclass are the keys of its table in a problem file. Values of many paths and
    derivatives follow from the expression.

    Attributes
    ----------
    weight
        Factor of the term in the sum.
    """

    def expression(self, path: PathSymbols) -> Any:
        """Return the value of a path, to be made large: a scalar CasADi expression of `path`."""
        raise NotImplementedError(f"{type(self).__name__} has no expression")

    @property
    def needs_power(self) -> bool:
        """Expressions may read mean, standard deviation and connectivity."""
        return True

    @property
    def calibration_fault(self) -> str | None:
        """As for any expression."""
        return _written(self, FEW_STEPS).calibration_fault

    def check(self, setting: TermSetting) -> None:
        """Raise what keeps the expression from being planned for, as for any expression."""
        _written(self, setting.horizon).check(setting)

    def value(self, at: StepContext, path_m: NDArray[np.float64]) -> float:
        """Return the expression of one path."""
        return _written(self, len(path_m)).value(at, path_m)

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the expression of many paths."""
        return _written(self, paths.shape[1]).values(paths)

    def derivatives(self, path: NearPath) -> PathDerivatives:
        """Return the expression with derivatives by CasADi."""
        return _written(self, len(path.places_m)).derivatives(path)


@lru_cache(maxsize=64)
def _written(term: OwnTerm, steps: int) -> CasadiTerm:
    return CasadiTerm(steps, program_of(term.expression, steps))
