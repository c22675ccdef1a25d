"""Imperfect detection, and data association: which report belongs to which evader, if to any.

Objects are missed, and there are false alarms. Rounds of all levels sample at common instants, so
that what is missed or imagined at an instant is the same at every level.

An evader explains a chain of reports, each within reach of the one before. A link is worth the
logarithm of how much likelier the report is from the evader than from a false alarm (equation
8.17). Chains that share no report and are worth most together are a flow of least cost, whose
linear programme has whole solutions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog  # pyright: ignore[reportUnknownVariableType]
from scipy.sparse import coo_array

from planopt.errors import InputError, PlanoptError
from planopt.pursuit.knowledge import Track
from planopt.pursuit.service import SnapshotService, require_number


@dataclass(frozen=True)
class Detector:
    """The detection probabilities of the motes."""

    # That an object is not detected at an instant, each instant on its own
    miss_probability: float = 0.0
    # Expected number of them on the whole grid at an instant, Poisson and uniform
    false_alarms: float = 0.0

    def __post_init__(self) -> None:
        require_number(self.miss_probability, "miss_probability", least=0.0)
        if self.miss_probability >= 1.0:
            raise InputError(f"{self.miss_probability!r} is not below 1", key="miss_probability")
        require_number(self.false_alarms, "false_alarms", least=0.0)


@dataclass(frozen=True, eq=False)
class Detections:
    """Everything that the grid detected."""

    sampled_s: NDArray[np.float64]  # (k,) instants, ascending
    positions_m: NDArray[np.float64]  # (k, 2)
    # (k,) which object it is, -1 for false alarms: for whoever keeps score
    objects: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Reports:
    """Reports of unknown origin."""

    sampled_s: NDArray[np.float64]  # (k,) when they were sampled
    reported_m: NDArray[np.float64]  # (k, 2) centres of sub-cells
    errors_m: NDArray[np.float64]  # (k,) how far off they are at most
    levels: NDArray[np.int64]  # (k,)
    numbers: NDArray[np.int64]  # (k,) of the detections that they report

    def __len__(self) -> int:
        return len(self.sampled_s)


def draw_detections(
    service: SnapshotService,
    tracks: list[Track],
    detector: Detector,
    times_s: tuple[float, float],
    generator: np.random.Generator,
) -> Detections:
    """Draw what is detected at every instant from the first to the last time."""
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
    """Return what the last completed rounds tell a mote."""
    # Shapes: mote (2,).
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


@dataclass(frozen=True)
class AssociationModel:
    """The assumptions about evaders and detection."""

    speed_max_m_s: float  # No evader is faster
    detector: Detector  # Misses and false alarms
    area_m2: float  # Where false alarms are spread
    # (L + 1,) time between the samples of each level. A link that skips instants at which both its
    # levels sample says that the evader was missed there.
    periods_s: NDArray[np.float64]

    def __post_init__(self) -> None:
        require_number(self.speed_max_m_s, "speed_max_m_s", above=0.0)
        require_number(self.area_m2, "area_m2", above=0.0)


LEAST_RATE = 1e-6
"""Stands for no misses and no false alarms, so that only links out of reach are impossible."""

INSTANT_SHARE = 1e-3
"""Share of a period by which rounding may move an instant."""


def associate(
    reports: Reports,
    starts_s: NDArray[np.float64],
    starts_m: NDArray[np.float64],
    starts_error_m: NDArray[np.float64],
    model: AssociationModel,
) -> NDArray[np.int64]:
    """Return which evader each report belongs to, -1 for none: the most likely chains together."""
    # Shapes: starts_s, starts_m, starts_error_m (n,).
    count = len(starts_s)
    if starts_m.shape != (count, 2) or starts_error_m.shape != (count,):
        raise InputError(
            f"starts of shapes {starts_s.shape}, {starts_m.shape} and {starts_error_m.shape} do "
            "not belong together",
            remedy="give (n,), (n, 2) and (n,)",
        )
    owners = np.full(len(reports), -1)
    before, after, worth = _links(
        np.concatenate([starts_s, reports.sampled_s]),
        np.vstack([starts_m, reports.reported_m]),
        np.concatenate([starts_error_m, reports.errors_m]),
        np.append(np.zeros(count, dtype=np.int64), reports.levels),
        count,
        model,
    )
    if not len(worth):
        return owners
    chosen = _best_chains(before, after, worth, count, len(reports))
    owner = np.concatenate([np.arange(count), owners])
    # Links lead forward in time, so that the owner of the one before is known.
    for link in chosen[np.argsort(after[chosen], kind="stable")].tolist():
        owner[after[link]] = owner[before[link]]
    return owner[count:]


def _links(
    sampled_s: NDArray[np.float64],
    places_m: NDArray[np.float64],
    errors_m: NDArray[np.float64],
    levels: NDArray[np.int64],
    starts: int,
    model: AssociationModel,
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Pairs of nodes within reach, the later a report, and what each pair is worth."""
    lapse_s = sampled_s[None, :] - sampled_s[:, None]
    reach_m = model.speed_max_m_s * lapse_s + errors_m[:, None] + errors_m[None, :]
    apart_m = np.linalg.norm(places_m[None, :] - places_m[:, None], axis=-1)
    linked = (lapse_s > 0.0) & (apart_m <= reach_m)
    linked[:, :starts] = False
    before, after = np.nonzero(linked)
    # Both levels sample at the instants of the coarser one.
    period_s = model.periods_s[np.maximum(levels[before], levels[after])]
    missed = np.floor(lapse_s[linked] / period_s - INSTANT_SHARE)
    alarms = max(model.detector.false_alarms, LEAST_RATE)
    # Full speed in an unknown direction, and an error uniform over the sub-cell of each report.
    moved_m2 = 0.5 * (model.speed_max_m_s * lapse_s[linked]) ** 2
    variance_m2 = moved_m2 + (errors_m[before] ** 2 + errors_m[after] ** 2) / 6.0
    fits = -0.5 * apart_m[linked] ** 2 / variance_m2 - np.log(2.0 * np.pi * variance_m2)
    sure = (1.0 - model.detector.miss_probability) * model.area_m2 / alarms
    unseen = np.log(max(model.detector.miss_probability, LEAST_RATE))
    return before, after, fits + np.log(sure) + unseen * np.maximum(0.0, missed)


def _best_chains(
    before: NDArray[np.intp],
    after: NDArray[np.intp],
    worth: NDArray[np.float64],
    starts: int,
    reports: int,
) -> NDArray[np.intp]:
    """Numbers of the links in the chains that are worth most together.

    A report has at most one link to it, and one from it only if there is one to it; a start has at
    most one from it.
    """
    links = np.arange(len(worth))
    late, early = before >= starts, before < starts
    # Rows: one link to each report, no more from it than to it, one from each start.
    row = [
        after - starts,
        reports + after - starts,
        reports + before[late] - starts,
        2 * reports + before[early],
    ]
    column = [links, links, links[late], links[early]]
    sign = np.repeat([1.0, -1.0, 1.0], [len(links), len(links), len(links)])
    rows = coo_array(
        (sign, (np.concatenate(row), np.concatenate(column))),
        shape=(2 * reports + starts, len(links)),
    )
    limits = np.repeat([1.0, 0.0, 1.0], [reports, reports, starts])
    share = _solved(-worth, rows, limits)
    if share is None:
        raise PlanoptError(f"the association of {reports} reports was not solved")
    return np.flatnonzero(share > 0.5)


def _solved(
    costs: NDArray[np.float64], rows: coo_array, limits: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """The vertex of ``rows x <= limits``, ``0 <= x <= 1`` that costs least; None if not found."""
    found = linprog(costs, A_ub=rows, b_ub=limits, bounds=(0.0, 1.0), method="highs-ds")
    return cast("NDArray[np.float64] | None", found.x)  # pyright: ignore[reportUnknownMemberType]
