"""Restricted maximum likelihood against the number of measurements, and its profiles."""

from __future__ import annotations

from time import perf_counter

import pytest
from conftest import Table
from pytest_benchmark.fixture import BenchmarkFixture
from scenes import munich, sampled

from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.fit import fit_channel
from planopt.channel.estimation.profile_likelihood import profiles_around

ROUNDS = 5
PROFILED = 300


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


def test_profiles(benchmark: BenchmarkFixture, table: Table) -> None:
    """Profiles of xi, beta and omega for the fit's figure, at the most measurements they use."""
    station = munich()[0].stations[0].site
    measurements = sampled(PROFILED)
    profile_s: list[float] = []

    def profiles() -> int:
        begun = perf_counter()
        found = profiles_around(measurements, station)
        profile_s.append(perf_counter() - begun)
        return len(found)

    assert benchmark.pedantic(profiles, rounds=ROUNDS, warmup_rounds=1) == 3
    table.add("profiles of three parameters", PROFILED, profile_s[-ROUNDS:])
