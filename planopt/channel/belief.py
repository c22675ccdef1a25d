"""What the robots know of the channel: fitted parameters and the posterior. Never the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import ChannelPosterior, extend


@dataclass(frozen=True)
class Belief:
    """Knowledge of one station's channel.

    Attributes
    ----------
    fit
        How the parameters were estimated, from the first measurements.
    posterior
        Prediction from all measurements so far.
    """

    fit: ChannelFit
    posterior: ChannelPosterior


def update(belief: Belief, more: Measurements) -> Belief:
    """Add measurements to the belief (seed, Algorithm 1); the fit is kept."""
    return replace(belief, posterior=extend(belief.posterior, more))
