"""Slots of the snapshot service for the mean and for the peak load.

``python benchmarks/snapshot_study.py slots`` prints the table.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from planopt.pursuit import SnapshotService, simulate_flooding

Row = tuple[Any, ...]


def slots(levels: range) -> Iterator[Row]:
    """Yield mean and peak load of each way to flood, and the least slot that keeps all rounds."""
    yield "levels", "border relays", "mean", "peak", "late at the mean, %", "kept from"
    for count in levels:
        service = SnapshotService(count, 1.0, 0.05, 4)
        for border in (True, False):
            free = simulate_flooding(service, border)
            sent, peak = np.arange(len(free.motes_by_load)), len(free.motes_by_load) - 1
            mean = float(np.average(sent, weights=free.motes_by_load))
            run = simulate_flooding(service, border, math.ceil(mean))
            late = 100.0 * run.late.sum() / run.due.sum()
            yield count, border, f"{mean:.2f}", peak, late, _least_slot(service, border, peak)


def _least_slot(service: SnapshotService, border: bool, peak: int) -> int:
    """The fewest blocks a slot from which on no round is late, by trying all below the peak."""
    blocks = peak
    while blocks > 1 and not simulate_flooding(service, border, blocks - 1).late.any():
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
