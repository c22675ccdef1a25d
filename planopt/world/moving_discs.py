"""Discs that move: obstacles straight during each step, and the other robots as they drive."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planopt.world.closest_approach import closest_approach_m
from planopt.world.timed_motion import TimedMotion, TimedWay


@dataclass(frozen=True, eq=False)
class MovingDiscs:
    """Where m discs are predicted over the next T steps: the planned ones, and those of braking.

    Attributes
    ----------
    names
        What messages call them.
    centres_m
        ``(m, T + 1, 2)`` now and at each step's end.
    radius_m
        ``(m, T)`` during each step.
    least_m
        ``(m,)`` how far a robot must stay from the disc.
    is_robot
        ``(m,)`` whether it is another robot; robots are points.
    ways
        ``(m,)`` of each disc the ways of its T steps; none where it goes straight and evenly.
    bulges_m
        ``(m, T)`` how far each may be from that.
    """

    names: tuple[str, ...]
    centres_m: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    least_m: NDArray[np.float64]
    is_robot: NDArray[np.bool_]
    ways: tuple[tuple[TimedWay, ...], ...] = ()
    bulges_m: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        bulges = [self.motion(number).bulges_m for number in range(len(self))]
        object.__setattr__(self, "bulges_m", np.reshape(bulges, self.radius_m.shape))

    def __len__(self) -> int:
        """How many there are, m."""
        return len(self.names)

    @property
    def apart_m(self) -> NDArray[np.float64]:
        """``(m, T)`` least distance of a robot from each centre as if that went straight."""
        return self.radius_m + self.least_m[:, None] + self.bulges_m

    @property
    def steps(self) -> int:
        """How many, T."""
        return int(self.radius_m.shape[1])

    def counted_steps(self, number: int, motion: TimedMotion) -> int:
        """For how many steps a motion must keep from disc number `number`.

        From other robots until all stand, from moving obstacles until it stands itself.
        """
        return self.steps if self.is_robot[number] else min(motion.steps, self.steps)

    def motion(self, number: int) -> TimedMotion:
        """How disc number `number` moves."""
        return TimedMotion(self.centres_m[number], self.ways[number] if self.ways else ())


NOTHING_MOVES = MovingDiscs(
    (), np.zeros((0, 1, 2)), np.zeros((0, 0)), np.zeros(0), np.zeros(0, dtype=np.bool_)
)
"""No disc at all."""


def joined_discs(first: MovingDiscs, second: MovingDiscs) -> MovingDiscs:
    """The discs of both, over as many steps."""
    if not len(first) or not len(second):
        return first if len(first) else second
    ways = [discs.ways or ((),) * len(discs) for discs in (first, second)]
    return MovingDiscs(
        (*first.names, *second.names),
        np.concatenate([first.centres_m, second.centres_m]),
        np.concatenate([first.radius_m, second.radius_m]),
        np.concatenate([first.least_m, second.least_m]),
        np.concatenate([first.is_robot, second.is_robot]),
        (*ways[0], *ways[1]),
    )


def passing_gaps_m(
    discs: MovingDiscs,
    step: int,
    starts_m: NDArray[np.float64],
    ends_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """By how much straight ways during one step keep more than they must from every disc; (m, ...).

    Parameters
    ----------
    discs
        What moves.
    step
        0 is the first.
    starts_m, ends_m
        ``(..., 2)`` places at the step's begin and end.
    """
    shape = (len(discs), *([1] * (starts_m.ndim - 1)), 2)
    before = discs.centres_m[:, step].reshape(shape)
    after = discs.centres_m[:, step + 1].reshape(shape)
    near = closest_approach_m(starts_m, ends_m, before, after)
    return near - discs.apart_m[:, step].reshape(shape[:-1])


def path_distances_m(discs: MovingDiscs, path_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least distance of a path (N + 1, 2) from each centre during each step; ``(m, N)``.

    As if both went straight and evenly.
    """
    centres = discs.centres_m[:, : len(path_m)]
    return closest_approach_m(path_m[:-1], path_m[1:], centres[:, :-1], centres[:, 1:])


def ways_gap_m(discs: MovingDiscs, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least of all gaps along each of many ways; infinite without discs.

    Parameters
    ----------
    discs
        What moves.
    ways_m
        ``(c, N + 1, 2)``.

    Returns
    -------
    (c,) array
        Metres more than must be kept; negative where a way comes too near.
    """
    if not len(discs):
        return np.full(len(ways_m), np.inf)
    places = int(ways_m.shape[1])
    centres = discs.centres_m[:, :places]
    near = closest_approach_m(
        ways_m[:, None, :-1], ways_m[:, None, 1:], centres[:, :-1], centres[:, 1:]
    )
    return (near - discs.apart_m[:, : places - 1]).min(axis=(1, 2))
