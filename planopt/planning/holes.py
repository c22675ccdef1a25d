"""Coverage holes on the way to a goal: where they are, how long, and why they are crossed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, connection_probability
from planopt.errors import NoPlanError
from planopt.planning.tolerances import margins_asked_db
from planopt.problems.problem import Problem

MOST_IN_WORDS = 4
"""Of more holes the longest are told of."""

SHORTEST_IN_WORDS_M = 0.5
"""Shorter ones are rounded to nothing."""


@dataclass(frozen=True)
class Hole:
    """A stretch of a path that misses the bound on connectivity."""

    from_m: tuple[float, float]  # (x, y) of its first and last place below the bound
    to_m: tuple[float, float]
    length_m: float  # Driven below the bound, half of the steps in and out included
    least_connectivity: float  # Least probability of connection in it
    to_end: bool  # Whether the path ends in it

    @property
    def words(self) -> str:
        """Return where it is and how long."""
        x, y = self.from_m
        return (
            f"{self.length_m:.0f} m from ({x:.1f}, {y:.1f}) m on, "
            f"connected with probability {self.least_connectivity:.2f} at least"
        )


@dataclass(frozen=True, eq=False)
class BlockedWay:
    """The cheapest way of a robot to its goal, which a hard bound on connectivity forbids.

    Attributes
    ----------
    robot
        Whose way it would be.
    way_m
        ``(n, 2)`` places from where the robot is to the goal.
    holes
        Where it misses the bound, in its order.
    """

    robot: str
    way_m: NDArray[np.float64]
    holes: tuple[Hole, ...]


class BlockedError(NoPlanError):
    """There is no path to a goal that keeps a hard bound on connectivity.

    Parameters
    ----------
    message
        Where contact would have to be left, in words.
    blocked
        The ways on which it would be left least.
    """

    def __init__(self, message: str, blocked: tuple[BlockedWay, ...]) -> None:
        super().__init__(message)
        self.blocked = blocked


def holes_along(
    places_m: NDArray[np.float64],  # (n, 2) of the path
    connectivity: NDArray[np.float64],  # (n,) P(connected) there
    is_below: NDArray[np.bool_],  # (n,) whether that misses the bound
) -> tuple[Hole, ...]:
    """Find the holes of a path."""
    lengths = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    share = 0.5 * (is_below[:-1].astype(float) + is_below[1:]) * lengths
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_below.astype(int), [0]])))
    holes: list[Hole] = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        begin, finish = places_m[first], places_m[end - 1]
        holes.append(
            Hole(
                (float(begin[0]), float(begin[1])),
                (float(finish[0]), float(finish[1])),
                float(share[max(first - 1, 0) : end].sum()),
                float(connectivity[first:end].min()),
                end == len(places_m),
            )
        )
    return tuple(holes)


def holes_on(
    problem: Problem, power: Prediction, places_m: NDArray[np.float64]
) -> tuple[Hole, ...]:
    """Find the holes of a path of places (n, 2), by what is believed."""
    threshold = problem.stations[0].threshold_dbm
    chance = connection_probability(power.mean_db, power.deviation_db, threshold)
    slack_db = problem.constraints.rule.slack_max_db or 0.0
    return holes_along(places_m, chance, margins_asked_db(problem, power) < -slack_db)


def holes_in_words(problem: Problem, holes: Sequence[Hole], verb: str = "crosses") -> list[str]:
    """Lines for people about holes on the way to a goal; the longest where there are many."""
    holes = [hole for hole in holes if hole.length_m >= SHORTEST_IN_WORDS_M]
    if not holes:
        return []
    price, p_min = problem.reach.outage_price, problem.constraints.p_min
    total_m = sum(hole.length_m for hole in holes)
    told = sorted(holes, key=lambda hole: -hole.length_m)[:MOST_IN_WORDS]
    lines = [f"{verb} a coverage hole of {hole.words}" for hole in holes if hole in told]
    if len(told) < len(holes):
        lines.append(f"{verb} {len(holes) - len(told)} shorter ones")
    lines.append(
        f"in all {total_m:.0f} m below constraints.p_min {p_min:g}, each metre at "
        f"objective.outage_price {price:g}"
    )
    return lines


def goal_in_words(problem: Problem, holes: Sequence[Hole]) -> list[str]:
    """A line for people where the goal itself is out of contact; none where it is not."""
    if not holes or not holes[-1].to_end:
        return []
    return [
        f"the goal {list(problem.goal_m)} is itself below constraints.p_min "
        f"{problem.constraints.p_min:g}, by what is measured so far"
    ]
