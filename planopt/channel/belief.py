"""The robots' belief about the channel: fitted parameters and posterior. Never the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import ChannelPosterior, extend
from planopt.short_repr import short_repr


@dataclass(frozen=True)
class Belief:
    """Knowledge of a station's channel, and of the channels of further stations.

    Attributes
    ----------
    fit
        How the parameters were estimated, from the first measurements.
    posterior
        Prediction from all measurements so far.
    further
        What is known of each further station of the problem, in its order; they have none.
    """

    fit: ChannelFit
    posterior: ChannelPosterior
    further: tuple[Belief, ...] = ()

    __repr__ = short_repr

    @property
    def posteriors(self) -> tuple[ChannelPosterior, ...]:
        """Return the posterior of each station, the first one's first."""
        return (self.posterior, *(belief.posterior for belief in self.further))


def update(belief: Belief, more: Measurements, *further: Measurements) -> Belief:
    """Add measurements to the belief (Algorithm 1 of [GM11]); the fit is kept.

    `further` are of further stations, in their order.
    """
    return replace(
        belief,
        posterior=extend(belief.posterior, more),
        further=tuple(
            replace(other, posterior=extend(other.posterior, taken))
            for other, taken in zip(belief.further, further, strict=True)
        ),
    )
