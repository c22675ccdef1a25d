"""Imperfect detection: objects that are missed, false alarms, and the reports a mote has of both.

Rounds of all levels sample at common instants, so that what is missed or imagined at an instant is
the same at every level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.pursuit.knowledge import Track
from planopt.pursuit.service import SnapshotService, require_number


@dataclass(frozen=True)
class Detector:
    """How well the motes detect.

    Attributes
    ----------
    miss_probability
        That an object is not detected at an instant, each instant on its own.
    false_alarms
        Expected number of them on the whole grid at an instant, Poisson and uniform.

    Raises
    ------
    InputError
        A probability is not below 1, or a number is negative.
    """

    miss_probability: float = 0.0
    false_alarms: float = 0.0

    def __post_init__(self) -> None:
        require_number(self.miss_probability, "miss_probability", least=0.0)
        if self.miss_probability >= 1.0:
            raise InputError(f"{self.miss_probability!r} is not below 1", key="miss_probability")
        require_number(self.false_alarms, "false_alarms", least=0.0)


@dataclass(frozen=True, eq=False)
class Detections:
    """Everything that the grid detected.

    Attributes
    ----------
    sampled_s
        ``(k,)`` instants, ascending.
    positions_m
        ``(k, 2)``.
    objects
        ``(k,)`` which object it is, -1 for false alarms: for whoever keeps score.
    """

    sampled_s: NDArray[np.float64]
    positions_m: NDArray[np.float64]
    objects: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Reports:
    """Reports of unknown origin.

    Attributes
    ----------
    sampled_s
        ``(k,)`` when they were sampled.
    reported_m
        ``(k, 2)`` centres of sub-cells.
    errors_m
        ``(k,)`` how far off they are at most.
    levels
        ``(k,)``.
    numbers
        ``(k,)`` of the detections that they report.
    """

    sampled_s: NDArray[np.float64]
    reported_m: NDArray[np.float64]
    errors_m: NDArray[np.float64]
    levels: NDArray[np.int64]
    numbers: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.sampled_s)


def draw_detections(
    service: SnapshotService,
    tracks: list[Track],
    detector: Detector,
    times_s: tuple[float, float],
    generator: np.random.Generator,
) -> Detections:
    """Draw what is detected at every instant from the first to the last time.

    Parameters
    ----------
    service
        The grid; its level-0 rounds sample at all instants.
    tracks
        The objects.
    detector
        How well it detects.
    times_s
        First and last time.
    generator
        Source of misses and false alarms.
    """
    first, last = (int(np.floor(time_s / service.periods_s[0])) for time_s in times_s)
    instants_s = np.arange(first, last + 1) * service.periods_s[0]
    sampled, places, objects = [np.zeros(0)], [np.zeros((0, 2))], [np.zeros(0, dtype=np.int64)]
    for number, track in enumerate(tracks):
        seen_s = instants_s[generator.random(len(instants_s)) >= detector.miss_probability]
        sampled.append(seen_s)
        places.append(track.at(seen_s))
        objects.append(np.full(len(seen_s), number))
    counts = generator.poisson(detector.false_alarms, len(instants_s))
    sampled.append(np.repeat(instants_s, counts))
    places.append(generator.uniform(0.0, service.side_m, (int(counts.sum()), 2)))
    objects.append(np.full(int(counts.sum()), -1))
    order = np.argsort(np.concatenate(sampled), kind="stable")
    return Detections(
        np.concatenate(sampled)[order],
        np.concatenate(places)[order],
        np.concatenate(objects)[order],
    )


def reports_at(
    service: SnapshotService, detections: Detections, mote: NDArray[np.int64], time_s: float
) -> Reports:
    """Return what the last completed rounds tell a mote.

    Parameters
    ----------
    service
        The grid.
    detections
        Everything detected.
    mote
        ``(2,)`` column and row.
    time_s
        Now.

    Returns
    -------
    Reports
        From coarse to fine, old to new. What levels that share an instant both tell comes from the
        finer one.
    """
    found: dict[int, int] = {}
    instants_s = service.sample_numbers(time_s) * service.periods_s
    # A thousandth of a round off is another number's rounding, not another instant.
    slack_s = 1e-3 * service.periods_s[0]
    for level in range(service.levels, -1, -1):
        first, last = np.searchsorted(
            detections.sampled_s, [instants_s[level] - slack_s, instants_s[level] + slack_s]
        )
        cells = service.cells(detections.positions_m[first:last], level)
        near = (np.abs(cells - (mote >> level)) <= 1).all(axis=1)
        found.update(dict.fromkeys((np.flatnonzero(near) + first).tolist(), level))
    numbers = np.array(list(found), dtype=np.int64)
    numbers = numbers[np.argsort(detections.sampled_s[numbers], kind="stable")]
    levels = np.array([found[number] for number in numbers.tolist()], dtype=np.int64)
    reported = [
        service.reported_m(detections.positions_m[number], level)
        for number, level in zip(numbers.tolist(), levels.tolist(), strict=True)
    ]
    return Reports(
        detections.sampled_s[numbers],
        np.array(reported, dtype=np.float64).reshape(-1, 2),
        np.array([service.error_bound_m(level) for level in levels.tolist()], dtype=np.float64),
        levels,
        numbers,
    )


def merge_reports(first: Reports, second: Reports) -> Reports:
    """Return the reports of both, of two reports of one detection the more exact one."""
    numbers = np.concatenate([first.numbers, second.numbers])
    levels = np.concatenate([first.levels, second.levels])
    order = np.lexsort((levels, numbers))
    keep = order[np.append(True, np.diff(numbers[order]) != 0)] if len(order) else order
    sampled_s = np.concatenate([first.sampled_s, second.sampled_s])
    keep = keep[np.argsort(sampled_s[keep], kind="stable")]
    return Reports(
        sampled_s[keep],
        np.concatenate([first.reported_m, second.reported_m])[keep],
        np.concatenate([first.errors_m, second.errors_m])[keep],
        levels[keep],
        numbers[keep],
    )
