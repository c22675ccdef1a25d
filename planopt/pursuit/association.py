"""Data association: which report belongs to which evader, and which to none.

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
from planopt.pursuit.detection import Detector, Reports
from planopt.pursuit.service import require_number


@dataclass(frozen=True)
class AssociationModel:
    """What is assumed of evaders and detection.

    Attributes
    ----------
    speed_max_m_s
        No evader is faster.
    detector
        Misses and false alarms.
    area_m2
        Where false alarms are spread.
    periods_s
        ``(L + 1,)`` time between the samples of each level. A link that skips instants at which
        both its levels sample says that the evader was missed there.
    """

    speed_max_m_s: float
    detector: Detector
    area_m2: float
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
    """Return which evader each report belongs to, -1 for none: the most likely chains together.

    Parameters
    ----------
    reports
        In the order of their sample times.
    starts_s, starts_m, starts_error_m
        ``(n,)``, ``(n, 2)`` and ``(n,)`` when and where each evader was last known to be, and how
        far off that may be.
    model
        What is assumed.

    Returns
    -------
    (k,) array

    Raises
    ------
    InputError
        Shapes do not belong together.
    """
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
