"""Which posterior serves what: proof rests on the full one, search on as much as it needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kriging import predict
from planopt.channel.nearest.nearby import NEIGHBOURS_BEYOND, predict_nearby
from planopt.channel.posterior import EXACT_LIMIT, ChannelPosterior
from planopt.channel.prediction import Prediction

SEARCH_EXACT_LIMIT = 1000
"""Up to this many measurements searches use the full posterior too."""
SEARCH_NEIGHBOURS = 128
"""Nearest measurements a place beyond that: some thousandths of a dB off, and no slower however
many there are."""


def certified_prediction(
    posterior: ChannelPosterior, positions_m: NDArray[np.float64]
) -> tuple[Prediction, str]:
    """Prediction that certificates rest on, and its name in them."""
    if len(posterior.measurements) <= EXACT_LIMIT:
        return predict(posterior, positions_m), "exact"
    nearby = predict_nearby(posterior, positions_m, NEIGHBOURS_BEYOND, keep=True)
    return nearby, f"neighbours:{NEIGHBOURS_BEYOND}"


def search_prediction(posterior: ChannelPosterior, positions_m: NDArray[np.float64]) -> Prediction:
    """Prediction that searches look at; what they find is certified afterwards."""
    if len(posterior.measurements) <= SEARCH_EXACT_LIMIT:
        return predict(posterior, positions_m)
    return predict_nearby(posterior, positions_m, SEARCH_NEIGHBOURS)
