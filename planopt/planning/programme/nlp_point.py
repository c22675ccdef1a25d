"""What any solver of a programme over a path is given, and what it gives back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Termination
from planopt.planning.programme.kkt import Bounds


@dataclass(frozen=True)
class NlpPoint:
    """What the solver returned.

    Attributes
    ----------
    positions_m
        ``(N, 2)``.
    slack_db
        ``(N,)``, or ``(0,)`` where no connectivity is bounded; variables that a programme has
        besides come after them.
    row_multipliers, variable_multipliers
        By row of the programme and by variable; positive at an upper bound, negative at a lower.
    termination
        Why it stopped.
    iterations
        Its count.
    """

    positions_m: NDArray[np.float64]
    slack_db: NDArray[np.float64]
    row_multipliers: NDArray[np.float64]
    variable_multipliers: NDArray[np.float64]
    termination: Termination
    iterations: int


def nlp_point(
    horizon: int,
    variables: NDArray[np.float64],
    row_multipliers: NDArray[np.float64],
    variable_multipliers: NDArray[np.float64],
    termination: Termination,
    iterations: int,
) -> NlpPoint:
    """A point from all variables in the programme's order: positions, two a stage, then slacks."""
    places = 2 * horizon
    return NlpPoint(
        variables[:places].reshape(horizon, 2),
        variables[places:],
        row_multipliers,
        variable_multipliers,
        termination,
        iterations,
    )


def lost_point(horizon: int, variables: int, rows: int) -> NlpPoint:
    """What stands for a solve that could not begin: no numbers at all."""
    nothing = np.full(variables, np.nan)
    failure = Termination.NUMERICAL_FAILURE
    return nlp_point(horizon, nothing, np.full(rows, np.nan), nothing, failure, 0)


SolveNlp = Callable[[NDArray[np.float64], NDArray[np.float64], Bounds, Bounds], NlpPoint]
"""From a start, parameters, and bounds of variables and of rows, in the programme's order."""
