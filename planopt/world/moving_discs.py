"""Discs that move straight during each step: predicted moving obstacles and other robots.

A disc grows with the uncertainty of its prediction (equation 6.5).
"""

import math
from dataclasses import dataclass, field

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.world.motion import StepCurve, TimedMotion, closest_approach_m
from planopt.world.workspace import MovingObstacle


@dataclass(frozen=True, eq=False)
class MovingDiscs:
    """Predicted motion of m discs over the next T steps, braking steps included."""

    names: tuple[str, ...]  # Names in messages
    centres_m: Floats  # (m, T + 1, 2) now and after each step
    radius_m: Floats  # (m, T) during each step
    least_m: Floats  # (m,) required distance of a robot from the disc
    is_robot: Mask  # (m,) True for other robots, which are points
    # (m,) curves of the T steps of each disc; empty if straight at constant speed
    curves: tuple[tuple[StepCurve, ...], ...] = ()
    bulges_m: Floats = field(init=False)  # (m, T) distance from straight uniform motion

    def __post_init__(self) -> None:
        bulges = [self.motion(number).bulges_m for number in range(len(self))]
        object.__setattr__(self, "bulges_m", np.reshape(bulges, self.radius_m.shape))

    def __len__(self) -> int:
        """Return the number of discs, m."""
        return len(self.names)

    @property
    def apart_m(self) -> Floats:
        """Required distance (m, T) of a robot from each centre in each step."""
        return self.radius_m + self.least_m[:, None] + self.bulges_m

    @property
    def steps(self) -> int:
        """Number of steps T."""
        return int(self.radius_m.shape[1])

    def counted_steps(self, number: int, motion: TimedMotion) -> int:
        """Return the number of steps during which a motion must avoid disc `number`."""
        # Other robots count until all are at rest, moving obstacles until this robot is at rest.
        return self.steps if self.is_robot[number] else min(motion.steps, self.steps)

    def motion(self, number: int) -> TimedMotion:
        """Return the motion of disc `number`."""
        return TimedMotion(self.centres_m[number], self.curves[number] if self.curves else ())


NOTHING_MOVES = MovingDiscs(
    (), np.zeros((0, 1, 2)), np.zeros((0, 0)), np.zeros(0), np.zeros(0, dtype=np.bool_)
)
"""Empty set of discs."""


def joined_discs(first: MovingDiscs, second: MovingDiscs) -> MovingDiscs:
    """Return the union of two sets of discs over the same number of steps."""
    if not len(first) or not len(second):
        return first if len(first) else second
    curves = [discs.curves or ((),) * len(discs) for discs in (first, second)]
    return MovingDiscs(
        (*first.names, *second.names),
        np.concatenate([first.centres_m, second.centres_m]),
        np.concatenate([first.radius_m, second.radius_m]),
        np.concatenate([first.least_m, second.least_m]),
        np.concatenate([first.is_robot, second.is_robot]),
        (*curves[0], *curves[1]),
    )


def passing_gaps_m(discs: MovingDiscs, step: int, starts_m: Floats, ends_m: Floats) -> Floats:
    """Return the excess (m, ...) of straight motions during `step` over the required distance."""
    # Shapes: starts_m, ends_m (..., 2).
    shape = (len(discs), *([1] * (starts_m.ndim - 1)), 2)
    before = discs.centres_m[:, step].reshape(shape)
    after = discs.centres_m[:, step + 1].reshape(shape)
    near = closest_approach_m(starts_m, ends_m, before, after)
    return near - discs.apart_m[:, step].reshape(shape[:-1])


def path_distances_m(discs: MovingDiscs, path_m: Floats) -> Floats:
    """Return the distance (m, N) of a path (N + 1, 2) from each centre during each step."""
    # Path and centres are assumed to move straight at constant speed within a step.
    centres = discs.centres_m[:, : len(path_m)]
    return closest_approach_m(path_m[:-1], path_m[1:], centres[:, :-1], centres[:, 1:])


def paths_gap_m(discs: MovingDiscs, paths_m: Floats) -> Floats:
    """Return the smallest separation margin along each of c paths; infinite without discs."""
    # Shapes: paths_m (c, N + 1, 2).
    if not len(discs):
        return np.full(len(paths_m), np.inf)
    places = int(paths_m.shape[1])
    centres = discs.centres_m[:, :places]
    near = closest_approach_m(
        paths_m[:, None, :-1], paths_m[:, None, 1:], centres[:, :-1], centres[:, 1:]
    )
    return (near - discs.apart_m[:, : places - 1]).min(axis=(1, 2))


def centres_at(obstacle: MovingObstacle, times_s: Floats) -> Floats:
    """Return the predicted centre (n, 2) of an obstacle at each of n times."""
    known = np.asarray(obstacle.times_s)
    places = np.asarray(obstacle.positions_m)
    after = np.maximum(times_s - known[-1], 0.0)
    return np.stack(
        [
            np.interp(times_s, known, places[:, axis]) + after * obstacle.velocity_m_s[axis]
            for axis in (0, 1)
        ],
        axis=1,
    )


def growth_m(obstacle: MovingObstacle, ahead_s: Floats) -> Floats:
    """Return the radius growth (n,) due to uncertainty over steps that end in `ahead_s` seconds."""
    deviation = np.hypot(obstacle.position_std_m, 0.5 * obstacle.acceleration_std_m_s2 * ahead_s**2)
    return deviation * math.sqrt(-2.0 * math.log((1.0 - obstacle.probability) / 2.0))


def predicted_discs(
    obstacles: tuple[MovingObstacle, ...],
    now_s: float,
    step_s: float,
    steps: int,
    clearance_m: float,
) -> MovingDiscs:
    """Return the predicted discs of moving obstacles over the next steps."""
    # A turn of a path within a step enlarges the radius by its distance from the line.
    times = now_s + step_s * np.arange(steps + 1, dtype=np.float64)
    centres = np.array([centres_at(obstacle, times) for obstacle in obstacles])
    radius = np.array(
        [
            obstacle.radius_m + _turn_m(obstacle, times) + growth_m(obstacle, times[1:] - now_s)
            for obstacle in obstacles
        ]
    )
    return MovingDiscs(
        tuple(obstacle.name for obstacle in obstacles),
        centres.reshape(-1, steps + 1, 2),
        radius.reshape(-1, steps),
        np.full(len(obstacles), clearance_m),
        np.zeros(len(obstacles), dtype=np.bool_),
    )


def _turn_m(obstacle: MovingObstacle, times_s: Floats) -> Floats:
    """Return the largest distances (n - 1,) of the centre from the chord of each step."""
    # Both are linear between turns, so the distance is largest at a turn.
    known = np.asarray(obstacle.times_s)
    turns = known[(known > times_s[0]) & (known < times_s[-1])]
    step = np.searchsorted(times_s, turns, side="right") - 1
    ends = centres_at(obstacle, times_s)
    share = ((turns - times_s[step]) / (times_s[step + 1] - times_s[step]))[:, None]
    chord = (1.0 - share) * ends[step] + share * ends[step + 1]
    farthest = np.zeros(len(times_s) - 1)
    away = np.linalg.norm(centres_at(obstacle, turns) - chord, axis=1)
    # A turn at the end of a step differs from the chord only by rounding.
    np.maximum.at(farthest, step, np.where(away > 1e-12, away, 0.0))
    return farthest
