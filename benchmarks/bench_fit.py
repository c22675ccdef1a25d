"""Restricted maximum likelihood against the number of measurements."""

from __future__ import annotations

from time import perf_counter

import pytest
from conftest import Table
from pytest_benchmark.fixture import BenchmarkFixture
from scenes import munich, sampled

from planopt.channel import ChannelFit, fit_channel

ROUNDS = 5


@pytest.mark.parametrize("count", [102, 300, 500])
def test_reml(benchmark: BenchmarkFixture, table: Table, count: int) -> None:
    """Fit all five parameters, censored measurements included."""
    station = munich()[0].stations[0].site
    measurements = sampled(count)
    fit_s: list[float] = []

    def fit() -> ChannelFit:
        begun = perf_counter()
        found = fit_channel(measurements, station)
        fit_s.append(perf_counter() - begun)
        return found

    found = benchmark.pedantic(fit, rounds=ROUNDS, warmup_rounds=1)
    table.add("fit, reml", count, fit_s[-ROUNDS:])
    assert found.measurements == count
