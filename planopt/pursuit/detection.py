"""Imperfect detection, and data association: which evader caused a report without a name.

Motes miss evaders and raise false alarms. All levels sample at the same times, so a miss or false
alarm affects every level. Each evader causes one chain of reports. A link between two reports has
the log-likelihood ratio to a false alarm as its weight (equation 8.22). Disjoint chains of maximum
total weight are a minimum-cost flow, whose linear programme has integer solutions.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import coo_array

from planopt.arrays import Floats, Indices, Mask
from planopt.errors import PlanoptError
from planopt.pursuit.service import Pair, Record, SnapshotRecords, SnapshotService, Track

LEAST_RATE = 1e-6
"""Rate assumed if there are no misses or false alarms, so that logarithms are finite."""

SAMPLES = 4096  # Number of sample times for which errors are drawn; the pattern is repeated

MAX_REPORTS = 40  # Number of the latest reports of a pursuer whose association may still change


@dataclass(frozen=True, eq=False)
class Report:
    """Report of an unnamed detection."""

    sample: int  # Sample time as a multiple of the level-0 period
    level: int
    record: Record


@dataclass(eq=False)
class _Ledger:
    """Reports that a pursuer has received, and their association."""

    starts: list[Report]  # Last report of each evader whose association is final
    reports: dict[tuple[int, int], Report] = field(default_factory=dict[tuple[int, int], Report])
    latest: list[Report] = field(default_factory=list[Report])  # (e,) last report of each chain
    final: int = -(1 << 62)  # Sample up to which association is final


class AssociatedRecords:
    """Records from motes that detect imperfectly and do not know which evader they see.

    Each pursuer collects the reports of its local motes and associates them with the evaders.
    """

    def __init__(
        self,
        service: SnapshotService,
        rates: tuple[float, float],  # Miss probability; expected number of false alarms per sample
        starts: Sequence[Record],  # Where the evaders rest until time 0
        speed_max_m_s: float,
        generator: np.random.Generator,
        lost: Mask | None = None,  # As for SnapshotRecords
    ) -> None:
        self._service, self._rates, self._lost = service, rates, lost
        self._speed_max_m_s = speed_max_m_s
        self._starts = [Report(-(1 << 62), 0, each) for each in starts]
        self._ledgers: dict[int, _Ledger] = {}
        self._missed = generator.random((len(starts), SAMPLES)) < rates[0]
        # False alarms are uniform over the square of the grid.
        counts = generator.poisson(rates[1], SAMPLES)
        self._alarm_samples = np.repeat(np.arange(SAMPLES), counts)
        self._alarms_m = generator.uniform(0.0, service.side_m, (len(self._alarm_samples), 2))

    def record(
        self,
        tracks: Sequence[Track],
        pair: Pair,
        place_m: Floats,
        time_s: float,
        last: Record | None,
    ) -> Record | None:
        """Return the last report in the chain of the evader; None before the first report."""
        pursuer, evader = pair
        if pursuer not in self._ledgers:
            self._ledgers[pursuer] = _Ledger(self._starts, latest=self._starts)
        ledger = self._ledgers[pursuer]
        if self._receive(ledger, tracks, place_m, time_s):
            self._associate(ledger)
        found = ledger.latest[evader]
        return None if found is self._starts[evader] else found.record

    def _receive(
        self, ledger: _Ledger, tracks: Sequence[Track], place_m: Floats, time_s: float
    ) -> bool:
        """Add the reports of the last rounds to a ledger; return whether any is new."""
        service = self._service
        mote, numbers = service.cells(place_m, 0), service.sample_numbers(time_s)
        new = False
        for level, number in enumerate(numbers.tolist()):
            sample = number << level
            lost = self._lost is not None and self._lost[level, number % self._lost.shape[1]]
            if lost or sample <= ledger.final:
                continue
            sampled_s, column = number * service.periods_s[level], sample % SAMPLES
            seen, alarms_m = ~self._missed[:, column], self._alarms_m[self._alarm_samples == column]
            places_m = np.array([each.at(sampled_s) for each in tracks])[seen]
            sources = [*np.flatnonzero(seen).tolist(), *range(-len(alarms_m), 0)]
            places_m = np.concatenate([places_m, alarms_m])
            near = (np.abs(service.cells(places_m, level) - (mote >> level)) <= 1).all(axis=1)
            reported_m, error_m = service.reported_m(places_m, level), service.error_bound_m(level)
            for index in np.flatnonzero(near).tolist():
                # A finer level reports the same detection more exactly.
                key = sample, sources[index]
                if key not in ledger.reports or ledger.reports[key].level > level:
                    record = Record(float(sampled_s), reported_m[index], error_m)
                    ledger.reports[key] = Report(sample, level, record)
                    new = True
        return new

    def _associate(self, ledger: _Ledger) -> None:
        """Update the chains of a ledger, and make the association of its oldest reports final."""
        known = sorted(ledger.reports.items(), key=lambda item: item[0][0])
        owners = self.associated(ledger.starts, [report for _, report in known])
        ledger.latest, starts = list(ledger.starts), list(ledger.starts)
        for left, (key, report), owner in zip(range(len(known), 0, -1), known, owners, strict=True):
            chains = (ledger.latest, starts) if left > MAX_REPORTS else (ledger.latest,)
            for chain in chains if owner >= 0 else ():
                chain[owner] = report
            if left > MAX_REPORTS:
                ledger.final = report.sample
                del ledger.reports[key]
        ledger.starts = starts

    def associated(self, starts: Sequence[Report], reports: Sequence[Report]) -> list[int]:
        """Return the evader index of each report in time order, or -1 for a false alarm."""
        count, nodes = len(starts), [*starts, *reports]
        before, after, worth = self._links(nodes, count)
        owners = [*range(count), *[-1] * len(reports)]
        if len(worth):
            chosen = _best_chains(before, after, worth, count, len(reports))
            # Links point forward in time, so the owner of the earlier report is known.
            for link in chosen[np.argsort(after[chosen], kind="stable")].tolist():
                owners[after[link]] = owners[before[link]]
        return owners[count:]

    def _links(self, nodes: Sequence[Report], count: int) -> tuple[Indices, Indices, Floats]:
        """Return indices of earlier and later nodes within reach, and the weights of the links."""
        sample = np.array([each.sample for each in nodes])
        level = np.array([each.level for each in nodes])
        # Evaders rest before time 0.
        at_s = np.array([max(0.0, each.record.sampled_s) for each in nodes])
        error_m = np.array([each.record.error_m for each in nodes])
        place_m = np.array([each.record.reported_m for each in nodes])
        apart_m = np.linalg.norm(place_m[None] - place_m[:, None], axis=-1)
        moved_m = self._speed_max_m_s * (at_s - at_s[:, None])
        linked = (sample > sample[:, None]) & (apart_m <= moved_m + error_m + error_m[:, None])
        linked[:, :count] = False
        before, after = np.nonzero(linked)
        # Both levels sample at the sample times of the coarser one.
        lapse = sample[after] - np.maximum(sample[before], 0)
        missed = np.maximum(0, lapse - 1 >> np.maximum(level[before], level[after]))
        # The velocity is uniform over directions, and errors are uniform over sub-cells.
        errors_m2 = (error_m[before] ** 2 + error_m[after] ** 2) / 6.0
        variance_m2 = 0.5 * moved_m[linked] ** 2 + errors_m2
        fits = -0.5 * apart_m[linked] ** 2 / variance_m2 - np.log(2.0 * np.pi * variance_m2)
        missing, alarms = (max(rate, LEAST_RATE) for rate in self._rates)
        gain = math.log((1.0 - missing) * self._service.side_m**2 / alarms)
        return before, after, fits + gain + math.log(missing) * missed


def _best_chains(
    before: Indices, after: Indices, worth: Floats, starts: int, reports: int
) -> NDArray[np.int64]:
    """Return the indices of the links in the disjoint chains of maximum total weight `worth`."""
    # Rows: at most one link to each report, none from it without one to it, one from each start.
    links = np.arange(len(worth))
    left = np.where(before >= starts, reports + before - starts, 2 * reports + before)
    row = np.concatenate([after - starts, reports + after - starts, left])
    sign = np.repeat([1.0, -1.0, 1.0], len(links))
    shape = 2 * reports + starts, len(links)
    rows = coo_array((sign, (row, np.tile(links, 3))), shape=shape)
    limits = np.repeat([1.0, 0.0, 1.0], [reports, reports, starts])
    found: Any = cast("Any", linprog)(
        -worth, A_ub=rows, b_ub=limits, bounds=(0.0, 1.0), method="highs-ds"
    )
    share = cast("Floats | None", found.x)
    if share is None:
        raise PlanoptError(f"the association of {reports} reports was not solved")
    return np.flatnonzero(share > 0.5)


RecordSource = SnapshotRecords | AssociatedRecords
"""Source of the pursuers' records."""
