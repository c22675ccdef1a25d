# pyright: basic
"""Derivatives of the filtered distance until connected (equation 4.15), by CasADi.

The same formula as :func:`planopt.objectives.until_connected.filtered_failing`, for solvers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planopt.objectives.until_connected import LEAST_SCORE


@dataclass(frozen=True)
class PassageProgramme:
    """Functions of z = (mean above threshold (h,), covariance (h, h), legs (h,), beyond), flat.

    Mean and covariance are there for each station in turn. The chances of no connection to each
    multiply: they are independent. The last of z is what ending without connection counts.
    """

    steps: int  # h, and how many stations there are
    stations: int
    value: Any  # Of z: the distance charged
    gradient: Any  # The same by z, of the covariance by its lower triangle only
    along: Any  # Of z and a direction: how the gradient changes along it


@cache
def passage_programme(steps: int, stations: int = 1) -> PassageProgramme:
    """Build the functions for a path of h = `steps` places; kept for each number."""
    size = steps * (steps + 1)
    z = ca.SX.sym("z", stations * size + steps + 1)
    each = [_failing(z[own * size : (own + 1) * size], steps) for own in range(stations)]
    legs = z[stations * size :]  # and beyond, the last
    distance = legs[0]
    for k in range(steps):
        failing = math.prod((own[k] for own in each[1:]), start=each[0][k])
        distance += failing * legs[k + 1]
    slope = ca.gradient(distance, z)
    way = ca.SX.sym("way", z.numel())
    return PassageProgramme(
        steps,
        stations,
        ca.Function("distance", [z], [distance]),
        ca.Function("slope", [z], [slope]),
        ca.Function("along", [z, way], [ca.jtimes(slope, z, way)]),
    )


def _failing(z: Any, steps: int) -> list[Any]:
    """The chance of no connection to one station up to each place, of its mean and covariance."""
    mean = [z[k] for k in range(steps)]
    covariance = [[z[steps * (1 + j) + i] for j in range(steps)] for i in range(steps)]
    failing: Any = 1.0
    found: list[Any] = []
    for k in range(steps):
        deviation = ca.sqrt(covariance[k][k])
        score = ca.fmax(-mean[k] / deviation, LEAST_SCORE)
        below = 0.5 * (1.0 + ca.erf(score / math.sqrt(2.0)))
        ratio = ca.exp(-0.5 * score * score) / math.sqrt(2.0 * math.pi) / below
        failing = failing * below
        found.append(failing)
        shrink = ratio * (ratio + score) / covariance[k][k]
        for i in range(k + 1, steps):
            mean[i] -= covariance[i][k] / deviation * ratio
            for j in range(k + 1, i + 1):
                covariance[i][j] -= covariance[i][k] * covariance[j][k] * shrink
    return found


def slopes_and_bends(
    programme: PassageProgramme,
    z: NDArray[np.float64],
    ways: NDArray[np.float64],
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Value, gradient (n,) and change of the gradient along each column of `ways` (n, d)."""
    return (
        float(programme.value(z)),
        np.asarray(programme.gradient(z)).ravel(),
        np.asarray(programme.along(z, ways)),
    )
