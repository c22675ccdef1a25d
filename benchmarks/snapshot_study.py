"""The snapshot service in numbers: slots and lost hops.

``python benchmarks/snapshot_study.py slots`` sizes slots for the mean and for the peak load.
``python benchmarks/snapshot_study.py hops`` loses hops, and counts what comes too late.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from planopt.pursuit.network import Flooding, simulate_flooding
from planopt.pursuit.service import SnapshotService

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


def main() -> None:
    """Read the command line and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", choices=("slots", "hops"))
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    given = parser.parse_args()
    studies: dict[str, Callable[[], Iterator[Row]]] = {
        "slots": lambda: slots(range(3, 7)),
        "hops": lambda: hops(5, given.runs, given.first_seed),
    }
    for row in studies[given.study]():
        cells = (f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row)
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
