"""Maps of 320 x 320 with deviation: against scikit-learn, by neighbours, and measurement by one."""

from __future__ import annotations

from functools import cache
from time import perf_counter

import numpy as np
import pytest
from conftest import Table
from pytest_benchmark.fixture import BenchmarkFixture

from planopt.channel.cached_map import CachedMap
from planopt.channel.factor import whiten
from planopt.channel.kernel import shadow_covariance_db2
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.path_loss import regressors
from planopt.channel.posterior import ChannelPosterior, condition, extend
from planopt.channel.prediction import Prediction
from planopt.channel.single_precision import predict_single
from planopt.channel.tile_map import TileMap
from planopt.world.raster import cell_centres_m

SIDE_M = 50.0
GRID = 320
CHANNEL = ChannelParameters(-10.0, 2.0, 4.0, 10.0, 1.99, Station((25.0, 25.0)))
"""The outdoor channel of the seed's Fig. 3."""

TILE, NEIGHBOURS = 8, 64
ROUNDS = 3
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
def scikit_learn_s(count: int) -> float:
    """Least seconds that scikit-learn takes for mean and deviation, theta known."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    data = measured(count)
    kernel = ConstantKernel(CHANNEL.shadow_std_db**2, "fixed") * Matern(
        CHANNEL.decorrelation_m, "fixed", nu=0.5
    ) + WhiteKernel(CHANNEL.multipath_std_db**2, "fixed")
    peer = GaussianProcessRegressor(kernel, alpha=0.0, optimizer=None)
    peer.fit(data.positions_m, data.power_dbm - path_loss_db(data.positions_m))
    taken = []
    for _ in range(ROUNDS):
        begun = perf_counter()
        peer.predict(lattice()[1], return_std=True)
        taken.append(perf_counter() - begun)
    return min(taken)


def timed(benchmark: BenchmarkFixture, work: object, rounds: int) -> list[float]:
    """Seconds of each of `rounds` calls of `work`."""
    taken: list[float] = []

    def once() -> None:
        begun = perf_counter()
        work()
        taken.append(perf_counter() - begun)

    benchmark.pedantic(once, rounds=rounds, warmup_rounds=1)
    return taken[-rounds:]


@pytest.mark.parametrize("count", [102, 1000])
def test_exact_map(benchmark: BenchmarkFixture, table: Table, count: int) -> None:
    """Every measurement, theta estimated, against scikit-learn's with theta known."""
    places = lattice()[1]
    taken = timed(benchmark, lambda: posterior(count).predict(places), ROUNDS)
    table.add("map, exact", count, taken)
    table.note(
        f"map, exact, {count}: {min(taken) / scikit_learn_s(count):.2f} of scikit-learn's "
        f"{1e3 * scikit_learn_s(count):.0f} ms; the triangular solve runs at "
        f"{solve_share_of_peak(count):.0%} of the speed of a matrix product"
    )


@pytest.mark.parametrize("count", [102, 1000])
def test_single_precision_map(benchmark: BenchmarkFixture, table: Table, count: int) -> None:
    """The same in single precision."""
    places = lattice()[1]
    taken = timed(benchmark, lambda: predict_single(posterior(count), places), ROUNDS)
    table.add("map, single precision", count, taken)
    error = errors(predict_single(posterior(count), places), exact(count))
    table.note(
        f"map, single precision, {count}: {min(taken) / scikit_learn_s(count):.2f} of "
        f"scikit-learn's time; at most {error[1]:.0e} dB and {error[3]:.0e} off in deviation"
    )


def test_neighbours_map(benchmark: BenchmarkFixture, table: Table) -> None:
    """From the nearest measurements, tile by tile."""
    count = 1000
    x = lattice()[0]
    found: list[TileMap] = []

    def build() -> None:
        tiles = TileMap(x, x, np.ones((GRID, GRID), dtype=bool), TILE, NEIGHBOURS)
        tiles.refresh(posterior(count))
        found.append(tiles)

    taken = timed(benchmark, build, ROUNDS)
    table.add("map, neighbours", count, taken)
    tiles = found[-1]
    error = errors(Prediction(tiles.mean_db.ravel(), tiles.deviation_db.ravel()), exact(count))
    table.note(
        f"map, {NEIGHBOURS} neighbours a tile of {TILE} x {TILE}, {count}: "
        f"{scikit_learn_s(count) / min(taken):.0f} times faster than scikit-learn; mean off by "
        f"{error[0]:.3f} dB on average, {error[1]:.2f} dB at most; deviation by {error[2]:.3%} on "
        f"average, {error[3]:.2%} at most"
    )
    assert error[0] < 0.03
    assert error[2] < 0.005


@pytest.mark.parametrize("count", [102, 500, 1000])
@pytest.mark.parametrize("kind", ["exact", "neighbours"])
def test_one_more(benchmark: BenchmarkFixture, table: Table, kind: str, count: int) -> None:
    """Take in one measurement and refresh the whole map."""
    x, places = lattice()
    kept = (
        CachedMap(places)
        if kind == "exact"
        else TileMap(x, x, np.ones((GRID, GRID), dtype=bool), TILE, NEIGHBOURS)
    )
    rng = np.random.default_rng(1)
    # The first extension takes a copy of the shared factor.
    now = [extend(posterior(count), another(rng))]
    kept.refresh(now[0])

    def learn() -> None:
        now[0] = extend(now[0], another(rng))
        kept.refresh(now[0])

    table.add(f"one more, {kind}", count, timed(benchmark, learn, STEPS))


def another(rng: np.random.Generator) -> Measurements:
    """One more measurement."""
    position = rng.uniform(0.0, SIDE_M, (1, 2))
    return Measurements(position, path_loss_db(position), np.zeros(1, dtype=bool))


def errors(found: Prediction, true: Prediction) -> tuple[float, float, float, float]:
    """Mean and largest error of the mean (dB) and of the deviation (relative)."""
    mean = np.abs(found.mean_db - true.mean_db)
    deviation = np.abs(found.deviation_db / true.deviation_db - 1.0)
    return float(mean.mean()), float(mean.max()), float(deviation.mean()), float(deviation.max())


def solve_share_of_peak(count: int) -> float:
    """Speed of the triangular solve (n^2 operations a place) as a share of a matrix product's."""
    columns = np.ones((count, 2**21 // count))
    square = np.ones((1024, 1024))
    solve_s, product_s = [], []
    for _ in range(ROUNDS):
        begun = perf_counter()
        whiten(posterior(count).factor, columns)
        solve_s.append(perf_counter() - begun)
        begun = perf_counter()
        square @ square
        product_s.append(perf_counter() - begun)
    return (count**2 * columns.shape[1] / min(solve_s)) / (2.0 * 1024**3 / min(product_s))
