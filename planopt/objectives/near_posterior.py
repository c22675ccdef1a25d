"""Objectives that ask for joint laws, at any number of measurements.

A joint law needs the factor of the measurements' covariance, which a posterior of very many does
not have. It is then conditioned anew on those near the places in question.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.nearest.nearby import NEIGHBOURS_BEYOND
from planopt.channel.posterior import ChannelPosterior, condition


def factored_near(posterior: ChannelPosterior, places_m: NDArray[np.float64]) -> ChannelPosterior:
    """`posterior` where it has a factor, else one that has, for `places_m` (n, 2).

    Each place is conditioned on at least the `NEIGHBOURS_BEYOND` measurements nearest to it; theta
    and its covariance stay those of all. It is a true posterior of less data.
    """
    if posterior.has_factor:
        return posterior
    used = np.unique(posterior.index.nearest(places_m, NEIGHBOURS_BEYOND)[0])
    near = condition(
        posterior.parameters,
        posterior.measurements.take(used),
        theta=posterior.theta_rule,
        exact_limit=len(used),
    )
    return replace(
        near,
        theta=posterior.theta,
        theta_covariance=posterior.theta_covariance,
        now_s=posterior.now_s,
    )
