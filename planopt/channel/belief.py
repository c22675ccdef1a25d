"""The robots' belief about the channel: fitted parameters and posterior."""

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
        Fit of the parameters to the initial measurements.
    posterior
        Posterior of all measurements so far.
    further
        Belief about each further station of the problem, in its order, without further ones.
    """

    fit: ChannelFit
    posterior: ChannelPosterior
    further: tuple[Belief, ...] = ()

    __repr__ = short_repr

    @property
    def posteriors(self) -> tuple[ChannelPosterior, ...]:
        """Return the posterior of each station, in the problem's order."""
        return (self.posterior, *(belief.posterior for belief in self.further))


def update(belief: Belief, more: Measurements, *further: Measurements) -> Belief:
    """Add measurements of the first and of further stations (Algorithm 1 of [GM11]); no refit."""
    return replace(
        belief,
        posterior=extend(belief.posterior, more),
        further=tuple(
            replace(other, posterior=extend(other.posterior, taken))
            for other, taken in zip(belief.further, further, strict=True)
        ),
    )
