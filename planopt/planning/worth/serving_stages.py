"""The serving power of every stage with exact derivatives: several stations for a solver.

The law of :mod:`planopt.channel.connection.serving_power`, with one difference, only here: its
deviation is held at what it is along the path that the programme is about. So

    mean = t_1 + c z,    deviation = c

with z the score of any station. Bounds on single steps, whatever their level, are kept by the same
places, and probabilities are exact, with gradient and Hessian; only how many dB a bound is kept by,
away from that path, is to first order.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.connection_law import LEAST_DEVIATION_DB, ConnectionLaw
from planopt.channel.connection.serving_power import Laws, any_score_derivatives
from planopt.channel.nearest.neighbours import neighbour_model
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.planning.proof.broad_prediction import Broad
from planopt.planning.proof.serving import Serving
from planopt.planning.worth.stage_prediction import StagePredictor
from planopt.targets.rounding import Derivatives, add_products

StagePower = tuple[Derivatives, Derivatives]
"""Mean and deviation of every stage."""


class ServingStages:
    """Predicts the serving power of every stage, again and again.

    Parameters
    ----------
    serving
        The stations.
    path_m
        ``(N, 2)`` the path that the measurements of each stage are nearest to.
    neighbours
        How many of them.
    """

    def __init__(self, serving: Serving, path_m: NDArray[np.float64], neighbours: int) -> None:
        self._thresholds_dbm = serving.thresholds_dbm
        self._laws = serving.laws
        self._stations = [
            StagePredictor(neighbour_model(posterior, path_m, neighbours))
            for posterior in serving.posteriors
        ]
        powers = [predict(path_m) for predict in self._stations]
        about = [Prediction(mean.value, deviation.value) for mean, deviation in powers]
        self._scale_db = serving.law(about).deviation_db

    def each(self, positions_m: NDArray[np.float64]) -> list[StagePower]:
        """Mean and deviation of each station's power of stage k at ``positions_m[k]``, (N, 2)."""
        return [predict(positions_m) for predict in self._stations]

    def law(self, powers: Sequence[StagePower]) -> StagePower:
        """Mean and deviation of the serving power, from those of each station's."""
        return serving_derivatives(powers, self._thresholds_dbm, self._scale_db, self._laws)

    def __call__(self, positions_m: NDArray[np.float64]) -> StagePower:
        """Mean and deviation of the serving power."""
        return self.law(self.each(positions_m))


def serving_derivatives(
    powers: Sequence[StagePower],
    thresholds_dbm: Sequence[float],
    scale_db: NDArray[np.float64],
    laws: Laws | None = None,
) -> StagePower:
    """Mean and deviation of the serving power of m stations, its deviation held at `scale_db`.

    With z_i = (mu_i - t_i) / s_i: dz_i = (dmu_i - z_i ds_i) / s_i,
    d2z_i = (d2mu_i - z_i d2s_i - dz_i ds_i' - ds_i dz_i') / s_i, and of their any-score z:
    dz = sum_i w_i dz_i, d2z = sum_i w_i d2z_i + sum_ij W_ij dz_i dz_j'.

    Parameters
    ----------
    powers
        Mean and deviation of each station's power at N places.
    thresholds_dbm
        ``(m,)``.
    scale_db
        ``(N,)`` c.
    laws
        Each station's law of connection; None where all powers are normal.
    """
    scores = [
        scores_of(mean, deviation, threshold, law)
        for (mean, deviation), threshold, law in zip(
            powers, thresholds_dbm, laws or [None] * len(powers), strict=True
        )
    ]
    z, weight, bend = any_score_derivatives(np.stack([score.value for score in scores]))
    gradient = np.stack([score.gradient for score in scores])
    first = np.einsum("in,ina->na", weight, gradient)
    second = np.einsum("in,ina->na", weight, np.stack([score.hessian for score in scores]))
    pulled = 0.5 * np.einsum("ijn,jna->ina", bend, gradient)
    for own, other in zip(gradient, pulled, strict=True):
        add_products(second, own, other)
    by_scale = scale_db[:, None]
    mean = Derivatives(thresholds_dbm[0] + scale_db * z, by_scale * first, by_scale * second)
    return mean, Derivatives(scale_db, np.zeros_like(first), np.zeros_like(second))


def scores_of(
    mean: Derivatives,
    deviation: Derivatives,
    threshold_dbm: float,
    law: ConnectionLaw | None = None,
) -> Derivatives:
    """How many deviations the mean of every stage is above a threshold, as a normal score."""
    spread = np.maximum(deviation.value, LEAST_DEVIATION_DB)
    z, by = (mean.value - threshold_dbm) / spread, (1.0 / spread)[:, None]
    first = by * (mean.gradient - z[:, None] * deviation.gradient)
    second = by * (mean.hessian - z[:, None] * deviation.hessian)
    add_products(second, first, -by * deviation.gradient)
    if law is None:
        return Derivatives(z, first, second)
    normal, slope, bend = law.normal_score_derivatives(z)
    second *= slope[:, None]
    add_products(second, first, 0.5 * bend[:, None] * first)
    return Derivatives(normal, slope[:, None] * first, second)


def stage_predictor(
    posterior: ChannelPosterior,
    broad: Broad | None,
    path_m: NDArray[np.float64],
    neighbours: int,
) -> StagePredictor | ServingStages:
    """What predicts the stages about a path (N, 2): several stations where `broad` has them."""
    if isinstance(broad, Serving):
        return ServingStages(broad, path_m, neighbours)
    return StagePredictor(neighbour_model(posterior, path_m, neighbours))


def stage_powers(
    predict: StagePredictor | ServingStages, positions_m: NDArray[np.float64]
) -> list[StagePower]:
    """Mean and deviation of each station's power of stage k at ``positions_m[k]``, (N, 2)."""
    return (
        predict.each(positions_m) if isinstance(predict, ServingStages) else [predict(positions_m)]
    )


def serving_of(predict: StagePredictor | ServingStages, powers: Sequence[StagePower]) -> StagePower:
    """What connectivity rests on, from :func:`stage_powers`."""
    return predict.law(powers) if isinstance(predict, ServingStages) else powers[0]
