"""Measurements pending from other robots of a team: their places count, whatever power they find.

Robots of a team plan one after the other. Each is told the plans that count already, and where the
others have been. Measurements there are taken for made, with the predicted power as their value:
that leaves every mean as it is, and lessens variances by just what a measurement there would, as
these do not depend on the value. A path's information given that of the others is then

    F(path | others) = F(path and others) - F(others),

so that the values of all robots, each given those before it, add up to that of the team.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.measurements import Measurements
from planopt.channel.posterior import ChannelPosterior, extend
from planopt.objectives.measuring import MeasuringRule
from planopt.problems.problem import Problem

MOST_DRIVEN = 256
"""Of the places that the others have been at, so many count, the nearest to the robot: farther ones
say nothing of the places that a plan can come to."""


@dataclass(frozen=True, eq=False)
class Pending:
    """Places of the other robots, as one robot is told them.

    Attributes
    ----------
    planned_m
        ``(N, 2)`` each: the places after each step of the plans that count.
    driven_m
        ``(k, 2)`` where the others have been after the steps of the run so far.
    """

    planned_m: tuple[NDArray[np.float64], ...] = ()
    driven_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))


NOTHING_PENDING = Pending()


def anticipated(
    posteriors: Sequence[ChannelPosterior],
    pending: Pending,
    position_m: NDArray[np.float64],
    spacing_m: float,
) -> tuple[ChannelPosterior, ...]:
    """Return the belief of each station's channel once the others' measurements are known.

    Parameters
    ----------
    posteriors
        The robot's own belief of each station.
    pending
        Places of the others.
    position_m
        ``(2,)`` where the robot is.
    spacing_m
        Nearer to each other, and to measurements, no place is measured.
    """
    away = np.linalg.norm(pending.driven_m - position_m, axis=1)
    near = np.sort(np.argsort(away, kind="stable")[:MOST_DRIVEN])
    places = np.vstack([pending.driven_m[near], *pending.planned_m])
    if len(places):
        taken = MeasuringRule.of(posteriors, spacing_m).takes(places[None])[0]
        places = places[taken]
    if not len(places):
        return tuple(posteriors)
    return tuple(_believing(posterior, places) for posterior in posteriors)


def _believing(posterior: ChannelPosterior, places_m: NDArray[np.float64]) -> ChannelPosterior:
    """The posterior as if the predicted power had been measured at `places_m` (n, 2)."""
    count = len(posterior.measurements) + len(places_m)
    known = replace(
        posterior,
        outcomes=None,
        # A factor that is there is kept: counting neighbours anew would take longer than its rows.
        exact_limit=max(posterior.exact_limit, count)
        if posterior.has_factor
        else posterior.exact_limit,
    )
    power = posterior.predict(places_m).mean_db
    times = np.full(len(places_m), posterior.now_s)
    return extend(known, Measurements(places_m, power, time_s=times))


def places_of_others(driven_m: Sequence[NDArray[np.float64]], number: int) -> NDArray[np.float64]:
    """Return the places (k, 2) of all robots but `number`, robot after robot."""
    others = [places for other, places in enumerate(driven_m) if other != number]
    return np.vstack([np.zeros((0, 2)), *others])


def counts_others(problem: Problem) -> bool:
    """Return whether robots are told what others of the team measure, and a term counts it."""
    return problem.planner.coordination == "joint" and any(
        term.counts_others for term in problem.terms
    )
