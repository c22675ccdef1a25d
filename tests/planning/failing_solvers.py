"""Solvers that fail, in place of the one that polishes paths."""

from dataclasses import replace

import numpy as np

from planopt.extend import Termination
from planopt.planning.programme import path_nlp
from planopt.planning.programme.solver import NlpPoint

CALL = path_nlp.call_nlp


def with_status(status, change):
    """A solver that reports a status and changes the positions that it found."""

    def call(*arguments):
        point = CALL(*arguments)
        return replace(point, positions_m=change(point.positions_m), termination=status)

    return call


def no_numbers(_solver, n, start, _parameters, _variable_bounds, row_bounds):
    """Return what a solver leaves after an evaluation error."""
    slacks = np.full(len(start) - 2 * n, np.nan)
    rows = np.full(len(row_bounds.lower), np.nan)
    lost = np.full(len(start), np.nan)
    return NlpPoint(np.full((n, 2), np.nan), slacks, rows, lost, Termination.NUMERICAL_FAILURE, 3)
