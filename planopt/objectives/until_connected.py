"""How far a robot drives along a path until it is connected (equation 4.16): a cost, in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.first_passage import first_passage
from planopt.channel.places import leg_lengths_m, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.near_posterior import factored_near

LATER = 1.1
"""What a metre counts that lies beyond a plan. Were it 1, a robot far from any chance of connection
could as well wait as drive."""

NOT_TRIED_DB = 1e3
"""So far below the threshold the searches' formula takes places that are no tries."""

LEAST_CHANCE = 1e-12
"""Of a place that is tried."""

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
    tried: NDArray[np.bool_] | None = None,
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
    tried
        ``(h,)`` which places are tries; at others it is known that there is no connection. None
        for all.
    """
    whole = _whole(path_m, settings)
    tries = np.ones(len(path_m), dtype=np.bool_) if tried is None else tried
    places = whole[np.concatenate([[True], tries])]
    failing = np.ones(len(places))
    for station, threshold in zip((posterior, *further), settings.thresholds_dbm, strict=True):
        if len(places) > 1:
            failing *= first_passage(
                factored_near(station, places),
                places,
                threshold,
                np.random.default_rng(SEED),
                disconnected_now=settings.disconnected_now,
                tolerance=TOLERANCE,
            ).not_connected
    after = failing[np.concatenate([[0], np.cumsum(tries)])]
    return float(leg_lengths_m(whole) @ after[:-1] + settings.beyond_m * after[-1])


def search_length_m(
    distance_m: NDArray[np.float64],
    chance: NDArray[np.float64],
    decorrelation_m: float,
) -> NDArray[np.float64]:
    """Return the expected length of a search by tries like one, R = D + (1 - P) (L + R).

    A try costs the way to its place, D. If it fails, as it does with the chance 1 - P, the power
    about the place is known, and the robot first has to leave its surroundings, L.

    Parameters
    ----------
    distance_m, chance
        ``(k,)`` D and P of places.
    decorrelation_m
        L, from which on another try is independent.
    """
    tried = distance_m + (1.0 - chance) * decorrelation_m
    return tried / np.maximum(chance, LEAST_CHANCE)


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
