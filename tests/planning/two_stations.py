"""Two stations at the two ends of a rectangle, of which neither serves all of it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from planopt import BaseStation, Problem
from planopt.channel import Belief
from planopt.planning.initial_data import Prepared
from tests.planning.scenes import (
    PowerAt,
    bad_everywhere,
    bad_where,
    belief_of,
    prepared_of,
    small_problem,
)

EAST_THRESHOLD_DBM = -75.0
"""Another one than the first station's; powers of the second are as much greater."""

west_power = bad_where(lambda x, y: x > 24.0)
"""Connected in the west, up to 24 m of 40."""


def east_power(positions_m: np.ndarray) -> np.ndarray:
    """Connected in the east, from 16 m on."""
    return bad_where(lambda x, y: x < 16.0)(positions_m) + 5.0


def silent(positions_m: np.ndarray) -> np.ndarray:
    """A station so far away that nothing is ever heard of it."""
    return bad_everywhere(positions_m) - 200.0


def with_station(problem: Problem, name: str = "east") -> Problem:
    """The problem with a second station in the east."""
    east = BaseStation(
        name=name,
        position_m=(40.0, 15.0),
        height_m=5.0,
        transmit_power_dbm=0.0,
        threshold_dbm=EAST_THRESHOLD_DBM,
        power_column="east_dbm",
    )
    return replace(problem, stations=(*problem.stations, east))


def two_station_problem(**changes: object) -> Problem:
    """The small problem of these tests, with two stations."""
    return with_station(small_problem(**changes))


def belief_in(problem: Problem, powers: Sequence[PowerAt]) -> Belief:
    """What readings of each station's power on a grid tell."""
    beliefs = [belief_of(alone(problem, k), power) for k, power in enumerate(powers)]
    return replace(beliefs[0], further=tuple(beliefs[1:]))


def prepared_in(problem: Problem, powers: Sequence[PowerAt]) -> Prepared:
    """The belief, and truths that are just these powers."""
    truths = [prepared_of(alone(problem, k), power).truths[0] for k, power in enumerate(powers)]
    return Prepared(tuple(truths), belief_in(problem, powers))


def alone(problem: Problem, station: int) -> Problem:
    """The problem with one of its stations."""
    return replace(problem, stations=(problem.stations[station],))


def alone_in(belief: Belief, station: int) -> Belief:
    """What is believed of one of the stations."""
    return replace((belief, *belief.further)[station], further=())


def swapped(problem: Problem) -> Problem:
    """The problem with its stations in the other order."""
    return replace(problem, stations=problem.stations[::-1])


def swapped_belief(belief: Belief) -> Belief:
    return replace(belief.further[0], further=(alone_in(belief, 0),))


def known_in(problem: Problem, belief: Belief) -> dict[str, Any]:
    """Belief of all stations, and the prediction that the bound rests on."""
    assert len(problem.stations) == len(belief.posteriors)
    return {"posteriors": belief.posteriors}
