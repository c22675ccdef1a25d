"""Maps of 320 x 320 with deviation from very many measurements: fit, condition, predict.

Each number of measurements has a process of its own, whose peak memory is its own too.
``--benchmark-disable`` runs a fiftieth of each. As a program, ``bench_many.py COUNT SHARE`` does
the work of one process and prints what it took.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from functools import cache
from time import perf_counter

import numpy as np
import pytest
from conftest import Table
from pytest_benchmark.fixture import BenchmarkFixture

from planopt import Measurements
from planopt.channel import (
    ChannelParameters,
    Station,
    condition,
    fit_channel,
    posterior_map,
    shadow_field_db,
)
from planopt.channel.parameters import regressors

GRID = 320
SPACING_M = 1.5
"""Distance of measurements, on average, whatever their number: a larger campaign covers more."""

COUNTS = [5_000, 20_000, 50_000]
CENSORED = [0.0, 0.2]
SMALL = 50
"""What the counts are divided by in a test run."""

MOST_S, MOST_GIB, MOST_GROWTH = 60.0, 4.0, 12.0
"""Goals: at 20,000 measurements; and from the first of `COUNTS` to the last."""


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("share", CENSORED)
def test_map(benchmark: BenchmarkFixture, table: Table, share: float, count: int) -> None:
    """One map; the time is that of the work alone, without the process's start."""
    count = count // SMALL if benchmark.disabled else count
    taken = benchmark.pedantic(lambda: in_a_process(count, share), rounds=1)
    name = f"fit and map, {share:.0%} censored"
    table.add(name, count, [taken["total_s"]])
    table.note(
        f"{name}, {count}: fit {taken['fit_s']:.1f} s, condition {taken['condition_s']:.1f} s, "
        f"predict {taken['predict_s']:.1f} s, peak {taken['peak_gib']:.2f} GiB"
    )
    if benchmark.disabled:
        return
    if count == 20_000:
        assert taken["total_s"] < MOST_S
        assert taken["peak_gib"] < MOST_GIB
    if count == COUNTS[-1]:
        growth = taken["total_s"] / in_a_process(COUNTS[0], share)["total_s"]
        table.note(f"{name}: {growth:.1f} times the time from {COUNTS[0]:,} to {count:,}")
        assert growth < MOST_GROWTH


@cache
def in_a_process(count: int, share: float) -> dict[str, float]:
    """What :func:`work` returns, from a process of its own."""
    ran = subprocess.run(
        [sys.executable, __file__, str(count), str(share)],
        capture_output=True,
        check=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    return json.loads(ran.stdout)


def work(count: int, share: float) -> dict[str, float]:
    """Seconds of fit, conditioning and map of `count` measurements, and the peak memory in GiB.

    `share` of the measurements is at the receiver's floor.
    """
    side_m = SPACING_M * count**0.5
    channel = ChannelParameters(-20.0, 3.0, 8.0, 20.0, 2.0, Station((0.3 * side_m, 0.4 * side_m)))
    measurements = drawn(count, share, side_m, channel)
    begun = perf_counter()
    fit = fit_channel(measurements, channel.station)
    fitted = perf_counter()
    posterior = condition(fit.parameters, measurements)
    conditioned = perf_counter()
    maps = posterior_map(posterior, (0.0, 0.0, side_m, side_m), side_m / GRID, -90.0)
    done = perf_counter()
    if maps.mean_db.values.shape != (GRID, GRID):
        raise AssertionError("the map is not of the size that is timed")
    return {
        "fit_s": fitted - begun,
        "condition_s": conditioned - fitted,
        "predict_s": done - conditioned,
        "total_s": done - begun,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def drawn(count: int, share: float, side_m: float, channel: ChannelParameters) -> Measurements:
    """Measurements at random places of a square, of a field that has a value for every metre."""
    rng = np.random.default_rng(0)
    cells = int(side_m) + 1
    field = shadow_field_db(
        (cells, cells), 1.0, channel.shadow_std_db, channel.decorrelation_m, rng
    ).values_db
    places = rng.uniform(0.0, side_m, (count, 2))
    column, row = places.astype(int).T
    power = regressors(places, channel.station) @ [channel.k_pl_db, channel.n_pl]
    power += field[row, column] + channel.multipath_std_db * rng.standard_normal(count)
    floor = np.quantile(power, share)
    return Measurements(places, np.maximum(power, floor), power < floor)


if __name__ == "__main__":
    print(json.dumps(work(int(sys.argv[1]), float(sys.argv[2]))))
