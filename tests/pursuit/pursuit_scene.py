"""Pursuits in open space, and records that are exact."""

from dataclasses import dataclass

import numpy as np

from planopt.pursuit import (
    DriveToReport,
    Evader,
    Pursuer,
    Record,
    Scene,
    StraightMotion,
    simulate_pursuit,
)


@dataclass(frozen=True)
class ExactRecords:
    """Where the evader is."""

    def record(self, tracks, pair, place_m, time_s, last):
        return Record(time_s, tracks[pair[1]].at(np.array(time_s)), 0.0)


def pursue(source, behaviour, seed, *, speeds=(1.0, 2.0), distance_m=60.0, radius_m=3.0, **options):
    """One pursuer after one evader in a random direction; steps of a tenth of a radius."""
    generator = np.random.default_rng(seed)
    angle = generator.uniform(0.0, 2.0 * np.pi)
    start = generator.uniform(-1000.0, 1000.0, 2)
    away = distance_m * np.array([np.cos(angle), np.sin(angle)])
    scene = Scene(
        (
            Pursuer(
                start,
                options.pop("motion", StraightMotion(speeds[1])),
                options.pop("policy", DriveToReport),
            ),
        ),
        (Evader(start + away, speeds[0], behaviour),),
        source,
        radius_m,
        options.pop("step_s", 0.1 * radius_m / speeds[1]),
        options.pop("max_steps", 20_000),
        **options,
    )
    return simulate_pursuit(scene, generator)
