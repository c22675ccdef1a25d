"""Whether a fit depends on the order of rows: ``fit_order.py LOG.csv X,Y CENSORED [ORDERS]``.

Shuffles the rows of a log (ten times, if nothing else is said), fits each, and prints for every
parameter the estimate, its standard error, and the range over the orders as a share of that error.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import process_time

import numpy as np

from planopt.channel import LogFormat, Station, fit_channel, read_log

PARAMETERS = ("k_pl_db", "n_pl", "shadow_std_db", "decorrelation_m", "multipath_std_db")
SEED = 0


def main(log: str, station: str, censored: str, orders: str = "10") -> None:
    """Fit in every order, and print the table."""
    measurements = read_log(Path(log), LogFormat(censored_column=censored))
    x, y = (float(part) for part in station.split(","))
    generator = np.random.default_rng(SEED)
    begun = process_time()
    fits = [
        fit_channel(measurements.take(generator.permutation(len(measurements))), Station((x, y)))
        for _ in range(int(orders))
    ]
    taken_s = (process_time() - begun) / len(fits)
    statuses = ", ".join(sorted({fit.status for fit in fits}))
    print(f"{log}: {len(measurements)} rows, {orders} orders, {taken_s:.1f} s a fit: {statuses}")
    print("| parameter | estimate | standard error | range over orders / standard error |")
    print("|---|---|---|---|")
    for name in PARAMETERS:
        values = np.array([getattr(fit.parameters, name) for fit in fits])
        error = fits[0].standard_errors[name]
        print(f"| {name} | {values[0]:.4g} | {error:.2g} | {np.ptp(values) / error:.2g} |")
    for warning in fits[0].warnings:
        print(warning)


if __name__ == "__main__":
    main(*sys.argv[1:])
