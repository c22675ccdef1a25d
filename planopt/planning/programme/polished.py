"""What a polish gives back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Termination


@dataclass(frozen=True)
class Polished:
    """What came out.

    Attributes
    ----------
    path_m
        ``(N, 2)``; only worth something if a verifier says so.
    slack_db
        ``(N,)`` missing dB.
    termination, iterations
        Why the solver stopped, after how many iterations.
    kkt_residual
        Unscaled, computed without the solver's derivatives.
    multipliers
        By name: ``speed`` (N,), ``line_end`` (N, lines), ``line_start`` (N - 1, lines),
        ``connectivity`` (N,).
    inputs
        ``(N, m)`` of a robot that cannot turn or stop at will; None of a single integrator.
    """

    path_m: NDArray[np.float64]
    slack_db: NDArray[np.float64]
    termination: Termination
    iterations: int
    kkt_residual: float
    multipliers: dict[str, NDArray[np.float64]]
    inputs: NDArray[np.float64] | None = None
