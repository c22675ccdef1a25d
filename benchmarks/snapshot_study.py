"""Slots of the snapshot service for the mean and for the peak load.

``python benchmarks/snapshot_study.py slots`` prints the table.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np

from planopt.pursuit import SnapshotService, simulate_flooding

Row = tuple[Any, ...]


def slots(levels: range) -> Iterator[Row]:
    """Yield mean and peak load of each way to flood, and the least slot that keeps all rounds."""
    yield "levels", "heads", "border relays", "mean", "peak", "late at the mean, %", "kept from"
    for count in levels:
        service = SnapshotService(count, 1.0, 0.05, 4)
        for heads in ("first", "middle"):
            for border in (True, False):
                free = simulate_flooding(service, heads, border)
                mean = int(np.ceil(free.mean_load))
                run = simulate_flooding(service, heads, border, mean)
                late = 100.0 * run.late.sum() / run.due.sum()
                least = _least_slot(service, heads, border, free.peak_load)
                yield count, heads, border, f"{free.mean_load:.2f}", free.peak_load, late, least


def _least_slot(service: SnapshotService, heads: Any, border: bool, peak: int) -> int:
    """The fewest blocks a slot from which on no round is late, by trying all below the peak."""
    blocks = peak
    while blocks > 1 and simulate_flooding(service, heads, border, blocks - 1).keeps_rounds:
        blocks -= 1
    return blocks


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", choices=("slots",))
    parser.parse_args()
    for row in slots(range(3, 7)):
        cells = (f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row)
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
