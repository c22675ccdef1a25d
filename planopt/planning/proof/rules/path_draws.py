"""Powers along a path in drawn channels, for rules on correlated steps.

One station's powers along a path are jointly normal. The serving power of several is not: their
channels are drawn, each by itself, as many each time and from the same seeds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.cholesky import semidefinite_factor
from planopt.channel.connection.serving_power import serving_power_dbm
from planopt.channel.joint import JointPrediction, joint_prediction
from planopt.channel.posterior import ChannelPosterior, factored_near
from planopt.errors import InputError
from planopt.planning.proof.predictions import Broad, Serving
from planopt.problems.problem import Problem

DRAWS, SEED = 10_000, 0
"""Number of drawn channels, and their seed."""

DOUBT = 0.01
"""The lower end of the interval of this one-sided doubt counts (Clopper and Pearson, 1934)."""

DRAWN = f"{DRAWS} drawn channels, lower end of the {1.0 - DOUBT:.0%} interval"
"""Name of the method."""

MOST_PROBABLE = 0.9995
"""Greatest p_min that the drawn channels can show."""


def require_shown(problem: Problem, words: str, remedy: str) -> None:
    """Raise an InputError where p_min is more than drawn channels can show."""
    p_min = problem.constraints.p_min
    if p_min > MOST_PROBABLE:
        raise InputError(
            f"is {p_min:g}, and more than {MOST_PROBABLE:g} cannot be shown {words}",
            file=problem.file,
            key="constraints.p_min",
            remedy=f"ask for less, or {remedy}",
        )


def share_at_least(count: int, of: int) -> float:
    """Lower end of the one-sided interval of a probability seen `count` times `of` so many."""
    if count == 0:
        return 0.0
    return float(np.asarray(betaincinv(count, of - count + 1, DOUBT), dtype=np.float64))


def path_prediction(posterior: ChannelPosterior, path_m: NDArray[np.float64]) -> JointPrediction:
    """Predict the powers at the places (N, 2) of a path jointly (equation 1.12).

    Where there are too many measurements for a factor, by the nearest to the path: a true posterior
    of less data.
    """
    return joint_prediction(factored_near(posterior, path_m), path_m)


def drawn_powers_dbm(prediction: JointPrediction, station: int = 0) -> NDArray[np.float64]:
    """Powers along the path in `DRAWS` channels, from each station's own seed; ``(DRAWS, N)``."""
    generator = np.random.default_rng([SEED, station] if station else SEED)
    normal = generator.standard_normal((DRAWS, len(prediction)))
    return prediction.mean_db + normal @ semidefinite_factor(prediction.covariance_db2).T


def path_draws_dbm(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], broad: Broad | None
) -> NDArray[np.float64]:
    """Powers along a path (N, 2) in drawn channels, of several stations the serving ones."""
    if not isinstance(broad, Serving):
        return drawn_powers_dbm(path_prediction(posterior, path_m))
    each = [
        drawn_powers_dbm(path_prediction(station, path_m), number)
        for number, station in enumerate(broad.posteriors)
    ]
    return serving_power_dbm(np.stack(each), broad.thresholds_dbm)
