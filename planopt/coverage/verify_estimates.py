"""Verifier that recomputes event estimates from readings, independently of the estimator."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.optimize import least_squares  # pyright: ignore[reportUnknownVariableType]

from planopt.arrays import Floats

WORSE = 0.1
"""Largest permitted excess of -2 log L of an estimate over that of the best position nearby."""
TOO_SMALL = 0.97
"""Smallest permitted ratio of a standard deviation to the recomputed one."""
HEADINGS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""Initial guesses of an event's velocity, in prior standard deviations."""
FINE = 1e-12
"""Relative tolerances of the least-squares solver."""


@dataclass(frozen=True)
class SignalModel:
    """Model ``K / ((d / scale)^2 + 1)`` of an event's readings, as used by the verifier."""

    noise_std: float
    strength: float
    strength_known: bool
    scale_m: float
    speed_std_m_s: float | None  # Prior standard deviation of velocity components; None: static


def _fitted(residuals: Callable[[Floats], Floats], first: Floats) -> Any:
    """Minimise the sum of squared residuals from an initial guess."""
    solver = cast("Any", least_squares)
    return solver(residuals, first, x_scale="jac", ftol=FINE, xtol=FINE, gtol=FINE)


def estimate_fault(
    model: SignalModel,
    positions_m: Floats,  # (r, 2) positions of the readings
    signal: Floats,  # (r,)
    ages_s: Floats,  # (r,) time from each reading to the estimate
    place_m: Floats,  # (2,) estimate and its standard deviation
    std_m: float,
    inner: bool,  # Whether the estimate is inside the region, not on its border
) -> str | None:
    """Return the reason why an estimate contradicts its readings; None if it agrees."""
    # The standard deviation may exceed the recomputed one, since it includes rival positions.
    moves, loud = model.speed_std_m_s is not None, not model.strength_known

    def residuals(values: Floats) -> Floats:
        """Return scaled residuals for `values`: position, velocity and strength."""
        velocity = values[2:4] if moves else np.zeros(2)
        offset = positions_m - (values[:2] - ages_s[:, None] * velocity)
        strength = values[-1] if loud else model.strength
        expected = strength / ((offset**2).sum(axis=1) / model.scale_m**2 + 1.0)
        prior = velocity / model.speed_std_m_s if model.speed_std_m_s is not None else np.zeros(0)
        return np.concatenate(((signal - expected) / model.noise_std, prior))

    # Velocity and strength are not saved; the best ones for the position are found first.
    away = ((positions_m - place_m) ** 2).sum(axis=1) / model.scale_m**2
    shape = 1.0 / (away + 1.0)
    rest, misfit = (
        np.zeros(0),
        float((residuals(place_m) ** 2).sum()) if not (moves or loud) else 0.0,
    )
    if moves or loud:
        guess = np.full(int(loud), float(shape @ signal / (shape @ shape)))
        speed = model.speed_std_m_s or 0.0
        turns = speed * HEADINGS if moves else np.zeros((1, 0))
        trials = [
            _fitted(lambda part: residuals(np.concatenate((place_m, part))), first)
            for first in (np.concatenate((turn, guess)) for turn in turns)
        ]
        best = min(trials, key=lambda trial: trial.cost)
        rest, misfit = cast("Floats", best.x), 2.0 * float(best.cost)
    found = _fitted(residuals, np.concatenate((place_m, rest)))
    jacobian = cast("Floats", found.jac)
    scale = np.linalg.norm(jacobian, axis=0)
    if not (scale > 0.0).all():
        return "the readings do not determine the position"
    even = jacobian / scale
    inverse = np.asarray(np.linalg.pinv(even.T @ even), dtype=np.float64)
    covariance = inverse / np.outer(scale, scale)
    best_m = float(np.sqrt(np.trace(covariance[:2, :2])))
    if inner and misfit > 2.0 * float(found.cost) + WORSE:
        off_m = float(np.linalg.norm(cast("Floats", found.x)[:2] - place_m))
        return f"the estimate is {off_m:.4g} m from the position that its readings determine"
    if inner and std_m < TOO_SMALL * best_m:
        return f"the standard deviation is {std_m:.4g} m, its readings have {best_m:.4g} m"
    return None
