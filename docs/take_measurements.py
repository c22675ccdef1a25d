"""Write the first measurements of a library problem as a power log: PROBLEM LOG.csv [SEED]."""

from __future__ import annotations

import sys
from pathlib import Path

from planopt import load
from planopt.files.writing import write_text
from planopt.planning.initial_data import prepare


def main(name: str, log: str, seed: str = "0") -> None:
    """Take the measurements that `planopt solve` starts from with this seed, and write them."""
    measured = prepare(load(name), int(seed)).belief.posterior.measurements
    rows = zip(measured.positions_m, measured.power_dbm, measured.censored, strict=True)
    lines = [f"{x:.3f},{y:.3f},{power:.4f},{int(floor)}" for (x, y), power, floor in rows]
    write_text(Path(log), "\n".join(["x_m,y_m,power_dbm,at_floor", *lines, ""]))
    print(f"{log}: {len(lines)} measurements, {measured.censored.sum()} of them at the floor")


if __name__ == "__main__":
    main(*sys.argv[1:])
