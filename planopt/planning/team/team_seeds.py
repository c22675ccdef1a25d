"""Split a random seed into the streams of a problem whose objective is a sum of terms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planopt.problems.problem import Problem


@dataclass(frozen=True, eq=False)
class TeamSeeds:
    """Streams apart from those of truth and measurements, so that other tasks leave these alone.

    Attributes
    ----------
    target
        Of the target's way, its first estimate and the sensors' noise.
    planners
        One a robot, for planners that draw.
    """

    target: np.random.Generator
    planners: tuple[np.random.Generator, ...]


def team_seeds(problem: Problem, seed: int) -> TeamSeeds:
    """The streams of `seed`, unused."""
    target, planners = np.random.SeedSequence(seed, spawn_key=(1,)).spawn(2)
    return TeamSeeds(
        np.random.default_rng(target),
        tuple(np.random.default_rng(stream) for stream in planners.spawn(len(problem.robots))),
    )
