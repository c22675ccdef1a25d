"""Maps of 320 x 320 with deviation: against scikit-learn, by neighbours, and measurement by one."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from time import perf_counter

import numpy as np
import pytest
from conftest import Table
from pytest_benchmark.fixture import BenchmarkFixture

from planopt import Measurements
from planopt.channel import ChannelParameters, ChannelPosterior, Prediction, Station, condition
from planopt.channel.channel_map import TileMap
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import regressors
from planopt.channel.posterior import extend
from planopt.world import cell_centres_m

SIDE_M = 50.0
GRID = 320
CHANNEL = ChannelParameters(-10.0, 2.0, 4.0, 10.0, 1.99, Station((25.0, 25.0)))
"""The outdoor channel of Fig. 3 of [GM11]."""

TILE, NEIGHBOURS = 10, 64
ROUNDS = 5
SMALL = 300
"""Measurements of the small version."""

STEPS = 20


@cache
def lattice() -> tuple[np.ndarray, np.ndarray]:
    """Coordinates along a side, and all cells (n, 2)."""
    x = cell_centres_m(0.0, SIDE_M, SIDE_M / GRID)
    return x, np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)


@cache
def measured(count: int) -> Measurements:
    """Measurements drawn from the channel."""
    rng = np.random.default_rng(0)
    positions = rng.uniform(0.0, SIDE_M, (count, 2))
    covariance = shadow_covariance_db2(positions, positions, CHANNEL)
    covariance += CHANNEL.multipath_std_db**2 * np.eye(count)
    power = path_loss_db(positions) + np.linalg.cholesky(covariance) @ rng.standard_normal(count)
    return Measurements(positions, power, np.zeros(count, dtype=bool))


def path_loss_db(positions_m: np.ndarray) -> np.ndarray:
    """Mean power."""
    return regressors(positions_m, CHANNEL.station) @ [CHANNEL.k_pl_db, CHANNEL.n_pl]


@cache
def posterior(count: int) -> ChannelPosterior:
    """Given these measurements."""
    return condition(CHANNEL, measured(count))


@cache
def exact(count: int) -> Prediction:
    """The exact map."""
    return posterior(count).predict(lattice()[1])


@cache
def scikit_learn(count: int) -> Callable[[], object]:
    """What scikit-learn does for mean and deviation, theta known."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    data = measured(count)
    kernel = ConstantKernel(CHANNEL.shadow_std_db**2, "fixed") * Matern(
        CHANNEL.decorrelation_m, "fixed", nu=0.5
    ) + WhiteKernel(CHANNEL.multipath_std_db**2, "fixed")
    peer = GaussianProcessRegressor(kernel, alpha=0.0, optimizer=None)
    peer.fit(data.positions_m, data.power_dbm - path_loss_db(data.positions_m))
    return lambda: peer.predict(lattice()[1], return_std=True)


def timed(
    benchmark: BenchmarkFixture,
    work: Callable[[], object],
    rounds: int,
    peer: Callable[[], object] | None = None,
) -> tuple[list[float], float]:
    """Seconds of each of `rounds` calls of `work`, and how much of `peer`'s time it takes.

    The two are called in turn, so that what else the machine does hits both; the ratio is of the
    least times.
    """
    taken: list[float] = []
    taken_by_peer: list[float] = []

    def before() -> None:
        if peer is not None:
            taken_by_peer.append(seconds(peer))

    benchmark.pedantic(
        lambda: taken.append(seconds(work)), setup=before, rounds=rounds, warmup_rounds=1
    )
    ratio = min(taken) / min(taken_by_peer) if taken_by_peer else float("nan")
    return taken[-rounds:], ratio


def seconds(work: Callable[[], object]) -> float:
    """How long one call takes."""
    begun = perf_counter()
    work()
    return perf_counter() - begun


@pytest.mark.parametrize("count", [102, 1000])
def test_exact_map(benchmark: BenchmarkFixture, table: Table, count: int) -> None:
    """Every measurement, theta estimated, against scikit-learn's with theta known."""
    count = min(count, SMALL) if benchmark.disabled else count
    taken, ratio = timed(
        benchmark, lambda: posterior(count).predict(lattice()[1]), ROUNDS, scikit_learn(count)
    )
    table.add("map, exact", count, taken)
    peak = product_speed()
    table.note(
        f"map, exact, {count}: {ratio:.2f} of scikit-learn's time; it does its n^2 operations a "
        f"place at {count**2 * GRID**2 / min(taken) / peak:.0%} of the speed of a matrix product, "
        f"{peak / 1e9:.0f} GFLOP/s"
    )


def test_neighbours_map(benchmark: BenchmarkFixture, table: Table) -> None:
    """From the nearest measurements, tile by tile."""
    count = SMALL if benchmark.disabled else 1000

    def work() -> TileMap:
        tiles = new_tiles()
        tiles.refresh(posterior(count))
        return tiles

    taken, ratio = timed(benchmark, work, ROUNDS, scikit_learn(count))
    table.add("map, neighbours", count, taken)
    tiles = work()
    error = errors(Prediction(tiles.mean_db.ravel(), tiles.deviation_db.ravel()), exact(count))
    table.note(
        f"map, {NEIGHBOURS} neighbours a tile of {TILE} x {TILE}, {count}: {1.0 / ratio:.0f} times "
        f"faster than scikit-learn; mean {error[0]:.3f} dB off on average, {error[1]:.2f} dB at "
        f"most, deviation {error[2]:.3%} and {error[3]:.2%}"
    )
    assert error[0] < 0.03
    assert error[2] < 0.005


def new_tiles() -> TileMap:
    """An empty map by neighbours."""
    x = lattice()[0]
    return TileMap(x, x, np.ones((GRID, GRID), dtype=bool), TILE, NEIGHBOURS)


@pytest.mark.parametrize("count", [102, 500, 1000])
def test_one_more(benchmark: BenchmarkFixture, table: Table, count: int) -> None:
    """Take in one measurement and refresh the whole map."""
    kept = new_tiles()
    rng = np.random.default_rng(1)
    # The first extension takes a copy of the shared factor.
    now = [extend(posterior(count), another(rng))]
    kept.refresh(now[0])

    def learn() -> None:
        now[0] = extend(now[0], another(rng))
        kept.refresh(now[0])

    table.add("one more, neighbours", count, timed(benchmark, learn, STEPS)[0])


def another(rng: np.random.Generator) -> Measurements:
    """One more measurement."""
    position = rng.uniform(0.0, SIDE_M, (1, 2))
    return Measurements(position, path_loss_db(position), np.zeros(1, dtype=bool))


def errors(found: Prediction, true: Prediction) -> tuple[float, float, float, float]:
    """Mean and largest error of the mean (dB) and of the deviation (relative)."""
    mean = np.abs(found.mean_db - true.mean_db)
    deviation = np.abs(found.deviation_db / true.deviation_db - 1.0)
    return float(mean.mean()), float(mean.max()), float(deviation.mean()), float(deviation.max())


def product_speed() -> float:
    """Operations a second of a product of two matrices of 1,024: the peak that can be reached."""
    square = np.ones((1024, 1024))
    return 2.0 * 1024**3 / min(seconds(lambda: square @ square) for _ in range(10))
