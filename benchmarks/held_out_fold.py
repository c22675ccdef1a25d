"""What a fold of many censored rows takes: ``held_out_fold.py LOG.csv X,Y``.

The floor is raised until 60 % of the log are censored. All but the first rows, 4,000 of them, are
learnt from, and the first ones predicted. Printed are processor times: compare them with that of
the matrix product, which a busy machine lengthens too.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import TypeVar

import numpy as np

from planopt.channel import LogFormat, Station, fit_channel, predictors_of, read_log

LEARNT, CENSORED_SHARE = 4_000, 0.6
PRODUCT_SIZE = 1_500

Result = TypeVar("Result")


def main(log: str, station: str) -> None:
    """Learn and predict one fold."""
    powers = read_log(Path(log), LogFormat()).power_dbm
    measured = read_log(Path(log), LogFormat(floor_dbm=float(np.quantile(powers, CENSORED_SHARE))))
    out, known = measured.take(slice(-LEARNT)), measured.take(slice(-LEARNT, None))
    x, y = (float(part) for part in station.split(","))
    site = Station((x, y))
    matrix = np.random.default_rng(0).random((PRODUCT_SIZE, PRODUCT_SIZE))
    timed("matrix product", lambda: matrix @ matrix)
    print(f"{len(known)} rows, {known.censored.mean():.0%} censored; {len(out)} held out")
    begun = process_time()
    fit = timed("fit", lambda: fit_channel(known, site))
    predictors = timed("learn", lambda: predictors_of(lambda _: fit)(known))
    for name, predict in predictors.items():
        timed(name, lambda predict=predict: predict(out))
    print(f"{'together':15}{process_time() - begun:8.2f} s")


def timed(name: str, work: Callable[[], Result]) -> Result:
    """Do the work, and print the processor time it took."""
    begun = process_time()
    done = work()
    print(f"{name:15}{process_time() - begun:8.2f} s", flush=True)
    return done


if __name__ == "__main__":
    main(*sys.argv[1:])
