"""How far a robot drives along a path until it is connected (theory 4.3): a cost, in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.first_passage import first_passage
from planopt.channel.places import leg_lengths_m, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.near_posterior import factored_near

SEED, TOLERANCE = 0, 1e-3
"""Of the integral that plans are compared by; it is mostly a hundred times more accurate."""


@dataclass(frozen=True)
class Search:
    """A search for connection.

    Attributes
    ----------
    start_m
        Where the robot stands.
    threshold_dbm
        Power from which on a place is connected.
    disconnected_now
        Given that it is not connected at the start. False where that is among the measurements.
    beyond_m
        What :func:`charged_distance_m` adds for a path that ends without connection.
    further_thresholds_dbm
        The same of further stations.
    """

    start_m: tuple[float, float]
    threshold_dbm: float
    disconnected_now: bool = True
    beyond_m: float = 0.0
    further_thresholds_dbm: tuple[float, ...] = ()

    @property
    def thresholds_dbm(self) -> tuple[float, ...]:
        """Of each station."""
        return (self.threshold_dbm, *self.further_thresholds_dbm)


def expected_distance_m(
    posterior: ChannelPosterior,
    path_m: NDArray[np.float64],
    settings: Search,
    generator: np.random.Generator,
) -> float:
    """E[D] = sum_k leg_{k+1} P(not connected at q_1 .. q_k), from the joint law of the places.

    :func:`planopt.channel.connection.first_passage.first_passage` has the distribution and the
    errors.

    Parameters
    ----------
    posterior
        The channel given measurements.
    path_m
        ``(h, 2)`` q_1 .. q_h. A robot that is never connected drives to the end.
    settings
        Start and threshold.
    generator
        Source of randomness of the integration.

    Raises
    ------
    InputError
        `path_m` is no path, or the start is certain to be connected.
    """
    whole = _whole(path_m, settings)
    return first_passage(
        factored_near(posterior, whole),
        whole,
        settings.threshold_dbm,
        generator,
        disconnected_now=settings.disconnected_now,
    ).expected_distance_m


def charged_distance_m(
    posterior: ChannelPosterior,
    path_m: NDArray[np.float64],
    settings: Search,
    further: Sequence[ChannelPosterior] = (),
) -> float:
    """E[D] + beyond_m P(not connected at q_1 .. q_h): what a plan that has to stop at h is charged.

    E[D] alone is least for a robot that stands still. The same numbers integrate every path, so
    that its value does not change. Stations are independent, so that the probabilities of no
    connection to each of them multiply. Arguments and errors as :func:`expected_distance_m`.

    Parameters
    ----------
    posterior, path_m, settings
        As there.
    further
        Of further stations.
    """
    whole = _whole(path_m, settings)
    each = [
        first_passage(
            factored_near(station, whole),
            whole,
            threshold,
            np.random.default_rng(SEED),
            disconnected_now=settings.disconnected_now,
            tolerance=TOLERANCE,
        )
        for station, threshold in zip((posterior, *further), settings.thresholds_dbm, strict=True)
    ]
    found = replace(each[0], not_connected=np.prod([own.not_connected for own in each], axis=0))
    return found.expected_distance_m + settings.beyond_m * float(found.not_connected[-1])


def independent_expected_distance_m(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], settings: Search
) -> float:
    """sum_k leg_{k+1} prod (1 - p) over the distinct places visited: as if independent.

    Cheap and without randomness, for searching. Too small where power is positively correlated.
    A place that repeats counts once, and not at all where it is the start and given not to be
    connected. Arguments as :func:`expected_distance_m`.
    """
    whole = _whole(path_m, settings)
    failing = 1.0 - posterior.connectivity(whole, settings.threshold_dbm)
    # The start itself is no trial; coming back to it is, unless it is given not to be connected.
    trials = whole if settings.disconnected_now else whole[1:]
    counts = np.zeros(len(whole), dtype=np.bool_)
    counts[len(whole) - len(trials) + np.unique(trials, axis=0, return_index=True)[1]] = True
    counts[0] = False
    survival = np.cumprod(np.where(counts, failing, 1.0))
    return float(leg_lengths_m(whole) @ survival[:-1])


def _whole(path_m: NDArray[np.float64], settings: Search) -> NDArray[np.float64]:
    """The path with its start in front; ``(h + 1, 2)``."""
    return np.vstack([np.asarray(settings.start_m, dtype=np.float64), require_places(path_m)])
