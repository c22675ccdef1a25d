"""Which posterior serves what: proof rests on the full one, search on as much as it needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kriging import predict
from planopt.channel.nearest.near_factors import NearFactors
from planopt.channel.nearest.nearby import NEIGHBOURS_BEYOND, predict_nearby
from planopt.channel.posterior import EXACT_LIMIT, ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.planning.proof.broad_prediction import Broad
from planopt.planning.proof.serving import Serving

KEPT_ERROR_DB = 1e-3
"""Predictions from groups of neighbours that were kept, and have grown, are off those from groups
made anew by less. In two runs from 6,000 measurements on, checked from disk, no difference was as
large; those looked at were 1.0e-4 to 1.4e-4 dB."""

SEARCH_EXACT_LIMIT = 1000
"""Up to this many measurements searches use the full posterior too."""
SEARCH_NEIGHBOURS = 128
"""Nearest measurements a place beyond that: some thousandths of a dB off, and no slower however
many there are."""

SEARCH_ERROR_DB = 2e-3
"""Beyond that, margins smaller than this are not relied on before they are certified."""


def is_search_exact(posterior: ChannelPosterior) -> bool:
    """Whether searches look at what certificates rest on."""
    return len(posterior.measurements) <= SEARCH_EXACT_LIMIT


def certified_prediction(
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],
    broad: Broad | None = None,
    *,
    keep: bool = True,
) -> tuple[Prediction, str]:
    """Prediction that certificates rest on, and its name in them; by `broad` where there is one.

    With `keep` the groups of neighbours may be those of an earlier step, grown; else they are made
    anew, in the same way wherever that is done.
    """
    if isinstance(broad, Serving):
        found = [certified_prediction(each, positions_m, keep=keep) for each in broad.posteriors]
        kind = next((kind for _, kind in found if kind != "exact"), "exact")
        return broad.law([prediction for prediction, _ in found]), kind
    if broad is not None:
        exact = len(posterior.measurements) <= EXACT_LIMIT
        return broad(positions_m), "exact" if exact else f"neighbours:{NEIGHBOURS_BEYOND}"
    if len(posterior.measurements) <= EXACT_LIMIT:
        return predict(posterior, positions_m), "exact"
    if not keep or posterior.near is None:
        posterior = replace(posterior, near=NearFactors())
    nearby = predict_nearby(posterior, positions_m, NEIGHBOURS_BEYOND, keep=True)
    return nearby, f"neighbours:{NEIGHBOURS_BEYOND}"


def search_prediction(
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],
    broad: Broad | None = None,
) -> Prediction:
    """Prediction that searches look at; what they find is certified afterwards."""
    if isinstance(broad, Serving):
        return broad.law([search_prediction(each, positions_m) for each in broad.posteriors])
    if broad is not None:
        return broad(positions_m)
    if is_search_exact(posterior):
        return predict(posterior, positions_m)
    return predict_nearby(posterior, positions_m, SEARCH_NEIGHBOURS)
