"""The snapshot service in numbers: slots, lost hops, sparse and directed updates, association.

``python benchmarks/snapshot_study.py slots`` sizes slots for the mean and for the peak load.
``python benchmarks/snapshot_study.py hops`` loses hops, and counts what comes too late.
``python benchmarks/snapshot_study.py updates`` compares full rounds with floods of changes alone,
and with floods towards a pursuer alone.
``python benchmarks/snapshot_study.py association`` misses evaders, adds false alarms, and counts
which reports are given to the right evader.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.pursuit.association import (
    AssociationModel,
    Detections,
    Detector,
    Reports,
    associate,
    draw_detections,
    merge_reports,
    reports_at,
)
from planopt.pursuit.flooding import Flooding, simulate_flooding
from planopt.pursuit.knowledge import Snapshot, Track, snapshot
from planopt.pursuit.service import SnapshotService
from planopt.pursuit.updates import Floods, Receiver, record_floods

Row = tuple[Any, ...]


def slots(levels: range) -> Iterator[Row]:
    """Yield mean and peak load of each way to flood, and the least slot that keeps all rounds."""
    yield "levels", "heads", "border relays", "mean", "peak", "late at the mean, %", "kept from"
    for count in levels:
        service = SnapshotService(count, 1.0, 0.05, 4)
        for heads in ("first", "middle"):
            for border in (True, False):
                free = simulate_flooding(service, Flooding(heads, border))
                at_mean = Flooding(heads, border, int(np.ceil(free.mean_load)))
                run = simulate_flooding(service, at_mean)
                late = 100.0 * run.late.sum() / run.due.sum()
                least = _least_slot(service, heads, border, free.peak_load)
                yield count, heads, border, f"{free.mean_load:.2f}", free.peak_load, late, least


def _least_slot(service: SnapshotService, heads: Any, border: bool, peak: int) -> int:
    """The fewest blocks a slot from which on no round is late, by trying all below the peak."""
    blocks = peak
    while (
        blocks > 1 and simulate_flooding(service, Flooding(heads, border, blocks - 1)).keeps_rounds
    ):
        blocks -= 1
    return blocks


def hops(levels: int, runs: int, first_seed: int) -> Iterator[Row]:
    """Yield what lost hops leave out, as the service is and with time to repeat them."""
    ways = {
        "three hops a round": (3, Flooding(slot_blocks=None)),
        "middle heads that wait": (3, Flooding("middle", gather_share=0.7)),
        "five hops a round, heads wait": (5, Flooding(gather_share=0.7)),
        "five hops, heads wait, records twice": (5, Flooding(repeats=2, gather_share=0.7)),
    }
    yield "way", "hop loss", "late records, %", "missing states, %", "blocks a mote and frame"
    for name, (per_round, flooding) in ways.items():
        service = SnapshotService(levels, 1.0, 0.05, 4, hops_per_round=per_round)
        for loss in (0.0, 0.05, 0.1, 0.3):
            lossy = Flooding(
                flooding.heads, True, None, flooding.repeats, flooding.gather_share, loss
            )
            found = [
                simulate_flooding(service, lossy, np.random.default_rng(seed))
                for seed in range(first_seed, first_seed + (runs if loss else 1))
            ]
            late = sum(run.late.sum() for run in found) / sum(run.due.sum() for run in found)
            missing = sum(run.missing.sum() for run in found) / sum(
                run.states.sum() for run in found
            )
            load = float(np.mean([run.mean_load for run in found]))
            yield name, loss, 100.0 * late, 100.0 * missing, load


UPDATES: dict[str, tuple[int | None, bool]] = {
    "every round": (1, False),
    "changes": (None, False),
    "changes and every 8th round": (8, False),
    "changes towards the pursuer": (None, True),
    "both": (8, True),
}
"""Which rounds are flooded even without a change, and whether towards the pursuer alone."""


def updates(levels: int, runs: int, first_seed: int) -> Iterator[Row]:
    """Yield what one object costs, and how often what the pursuer remembers is wrong."""
    yield "motes a frame", "floods", "blocks a frame", "of every round", "wrong at loss 0", 0.1, 0.3
    for moved in (0.002, 0.01, 0.05):
        service = SnapshotService(levels, 1.0, 1.0, 3)
        # Four rounds of the coarsest level.
        duration_s = 4.0 * float(service.periods_s[-1])
        every = 0.0
        for name, (refresh, directed) in UPDATES.items():
            blocks, wrong = 0, np.zeros(3)
            for seed in range(first_seed, first_seed + runs):
                evader = walk(service, moved, duration_s, seed)
                pursuer = walk(service, 2.0 * moved, duration_s, seed + 10**6)
                floods = record_floods(
                    service,
                    evader,
                    duration_s,
                    refresh_rounds=refresh,
                    receiver=Receiver(pursuer, 2.0 * moved) if directed else None,
                )
                blocks += sum(one.blocks for one in floods)
                for number, loss in enumerate((0.0, 0.1, 0.3)):
                    generator = np.random.default_rng((seed, number))
                    wrong[number] += wrong_share(service, evader, pursuer, floods, loss, generator)
            a_frame = blocks / (runs * duration_s / service.frame_s)
            every = every or a_frame
            yield moved, name, a_frame, f"{100 * a_frame / every:.1f} %", *(100.0 * wrong / runs)


def wrong_share(
    service: SnapshotService,
    evader: Track,
    pursuer: Track,
    floods: list[Floods],
    loss: float,
    generator: np.random.Generator,
) -> float:
    """Return how often the record that a pursuer takes is not the last round's of any level.

    It walks from mote to mote and hears what the mote under it remembers; a mote misses a flood
    with the probability `loss`, each on its own.
    """
    times_s = np.linspace(2.0 * float(service.periods_s[-1]), float(evader.times_s[-1]), 200)
    wrong = 0
    for time_s in times_s.tolist():
        mote = service.cells(pursuer.at(np.array(time_s)), 0)
        now = snapshot(service, evader, time_s)
        wrong += not _told(service, mote, floods, now, loss, generator)
    return wrong / len(times_s)


def _told(
    service: SnapshotService,
    mote: NDArray[np.int64],
    floods: list[Floods],
    now: Snapshot,
    loss: float,
    generator: np.random.Generator,
) -> bool:
    """Whether the finest record that the mote remembers is what full rounds tell."""
    for level, one in enumerate(floods):
        reached = (one.areas[:, 0] <= mote).all(axis=1) & (mote <= one.areas[:, 1]).all(axis=1)
        reached &= one.sampled_s + service.rounds_s[level] <= now.time_s + 1e-9
        reached &= generator.random(len(reached)) >= loss
        heard = np.flatnonzero(reached)
        held: tuple[int, ...] | None = None
        for number in heard[np.argsort(one.sampled_s[heard], kind="stable")].tolist():
            cell = tuple(one.cells[number].tolist())
            if one.occupied[number]:
                held = cell
            elif cell == held:
                held = None
        if held is not None:
            right = held == tuple(now.cells[level].tolist())
            return right and level == int(now.shown_at(mote).argmax())
    return False


def association(runs: int, first_seed: int) -> Iterator[Row]:
    """Yield shares of reports that find their evader, by min-cost flow and by the nearest one."""
    yield "evaders", "missed", "false alarms", "found, %", "wrong, %", "nearest found", "wrong"
    service = SnapshotService(6, 1.0, 0.05, 3)
    for count in (2, 5):
        for missed, alarms in ((0.0, 0.0), (0.2, 0.5), (0.2, 2.0), (0.5, 2.0), (0.2, 8.0)):
            model = AssociationModel(
                0.5, Detector(missed, alarms), service.side_m**2, service.periods_s
            )
            tallies = np.zeros((2, 4))
            for seed in range(first_seed, first_seed + runs):
                tracks = [walk(service, 0.5, 40.0, 1000 * seed + each) for each in range(count)]
                detections = draw_detections(
                    service, tracks, model.detector, (0.2, 40.0), np.random.default_rng(seed)
                )
                reports = heard(service, detections, np.array([32, 32]))
                starts = np.array([track.positions_m[0] for track in tracks])
                exact = np.zeros(count)
                truth = detections.objects[reports.numbers]
                for row, way in enumerate((associate, nearest)):
                    found = way(reports, exact, starts, exact, model)
                    given, real = found >= 0, truth >= 0
                    right = given & (found == truth)
                    tallies[row] += right.sum(), real.sum(), (given & ~right).sum(), given.sum()
            shares = [(row[0] / row[1], row[2] / max(1.0, row[3])) for row in tallies]
            yield count, missed, alarms, *(100.0 * np.array(shares).ravel())


def heard(service: SnapshotService, detections: Detections, mote: NDArray[np.int64]) -> Reports:
    """Return all reports that a mote had from 10 s to 40 s."""
    reports = reports_at(service, detections, mote, 10.0)
    for time_s in np.arange(10.0, 40.0, service.periods_s[0]):
        reports = merge_reports(reports, reports_at(service, detections, mote, time_s))
    return reports


def nearest(
    reports: Reports,
    starts_s: NDArray[np.float64],
    starts_m: NDArray[np.float64],
    starts_error_m: NDArray[np.float64],
    model: AssociationModel,
) -> NDArray[np.int64]:
    """Return the evader within reach whose last report is nearest, one report after the other."""
    when, where, off = starts_s.copy(), starts_m.copy(), starts_error_m.copy()
    owners = np.full(len(reports), -1)
    for number in range(len(reports)):
        lapse_s = reports.sampled_s[number] - when
        away_m = np.linalg.norm(where - reports.reported_m[number], axis=1)
        reach_m = model.speed_max_m_s * lapse_s + off + reports.errors_m[number]
        away_m[(lapse_s <= 0.0) | (away_m > reach_m)] = np.inf
        owner = int(away_m.argmin())
        if np.isfinite(away_m[owner]):
            owners[number], when[owner] = owner, reports.sampled_s[number]
            where[owner], off[owner] = reports.reported_m[number], reports.errors_m[number]
    return owners


def walk(service: SnapshotService, speed_m_s: float, lasts_s: float, seed: int) -> Track:
    """Return an object that turns at random, folded back at the edges of the grid."""
    generator = np.random.default_rng(seed)
    steps = 400
    step_s = lasts_s / steps
    turns = generator.normal(0.0, 0.3, steps).cumsum() + generator.uniform(0.0, 2.0 * np.pi)
    moves = speed_m_s * step_s * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    places = generator.uniform(0.0, service.side_m, 2) + np.vstack([[0.0, 0.0], moves.cumsum(0)])
    places = np.abs(np.mod(places + service.side_m, 2.0 * service.side_m) - service.side_m)
    return Track(np.arange(steps + 1) * step_s, places)


def main() -> None:
    """Read the command line and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", choices=("slots", "hops", "updates", "association"))
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    given = parser.parse_args()
    studies: dict[str, Callable[[], Iterator[Row]]] = {
        "slots": lambda: slots(range(3, 7)),
        "hops": lambda: hops(5, given.runs, given.first_seed),
        "updates": lambda: updates(7, given.runs, given.first_seed),
        "association": lambda: association(given.runs, given.first_seed),
    }
    for row in studies[given.study]():
        cells = (f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row)
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
