"""Choose the law of connectivity and the posterior that predictions rest on.

Certificates rest on all measurements, searches on a nearby subset.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity_law import ConnectivityLaw, StationsLaw, UncertainParameters
from planopt.channel.kriging import predict
from planopt.channel.local_channel import NEIGHBOURS_BEYOND, predict_nearby
from planopt.channel.parameter_uncertainty import marginalise
from planopt.channel.posterior import EXACT_LIMIT, ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.problems.problem import Problem

SEARCH_EXACT_LIMIT = 1000
"""Up to this many measurements searches use the full posterior too."""
SEARCH_NEIGHBOURS = 128
"""Number of nearest measurements per position beyond that: the error is some thousandths of a dB,
and the time does not depend on their number."""

SEARCH_ERROR_DB = 2e-3
"""Beyond that, margins smaller than this are not relied on before they are certified."""


def is_search_exact(posterior: ChannelPosterior) -> bool:
    """Return whether searches look at what certificates rest on."""
    return len(posterior.measurements) <= SEARCH_EXACT_LIMIT


def certified_prediction(
    law: ConnectivityLaw, positions_m: NDArray[np.float64]
) -> tuple[Prediction, str]:
    """Prediction that certificates rest on, and the name of its posterior in them."""
    most = max(len(station.measurements) for station in law.posteriors)
    kind = "exact" if most <= EXACT_LIMIT else f"neighbours:{NEIGHBOURS_BEYOND}"
    return law.power(positions_m, _certified_power), kind


def _certified_power(posterior: ChannelPosterior, positions_m: NDArray[np.float64]) -> Prediction:
    if len(posterior.measurements) <= EXACT_LIMIT:
        return predict(posterior, positions_m)
    return predict_nearby(posterior, positions_m, NEIGHBOURS_BEYOND)


def search_prediction(law: ConnectivityLaw, positions_m: NDArray[np.float64]) -> Prediction:
    """Prediction that searches look at; what they find is certified afterwards."""
    return law.power(positions_m, search_power)


def search_power(posterior: ChannelPosterior, positions_m: NDArray[np.float64]) -> Prediction:
    """Prediction of one station's power that searches look at."""
    if is_search_exact(posterior):
        return predict(posterior, positions_m)
    return predict_nearby(posterior, positions_m, SEARCH_NEIGHBOURS)


def stations_law(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> StationsLaw:
    """Return the law of a connection to any station."""
    thresholds = tuple(radio.threshold_dbm for radio in problem.stations)
    return StationsLaw(tuple(posteriors), thresholds, problem.constraints.p_min)


def uncertain_law(
    problem: Problem, posteriors: Sequence[ChannelPosterior]
) -> ConnectivityLaw | None:
    """Return the law with all parameters uncertain if the problem requires it, else None."""
    if problem.constraints.rule.parameter_uncertainty == "path_loss":
        return None
    plain = stations_law(problem, posteriors)
    (posterior,) = plain.posteriors
    marginal = marginalise(posterior.parameters, posterior.measurements)
    return UncertainParameters(plain.posteriors, plain.thresholds_dbm, plain.p_min, marginal)


def connectivity_law(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> ConnectivityLaw:
    """Return the law that the chance constraint rests on."""
    return uncertain_law(problem, posteriors) or stations_law(problem, posteriors)
