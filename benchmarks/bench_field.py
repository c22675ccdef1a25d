"""Exact shadowing fields against the length of the torus that they need."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import pytest
from conftest import Table
from pytest_benchmark.fixture import BenchmarkFixture

from planopt.channel.shadow_fields import ShadowField, shadow_field_pair_db

CELLS = 320
ROUNDS = 7


@pytest.mark.parametrize("decorrelation_cells", [20, 150, 190])
def test_two_fields(benchmark: BenchmarkFixture, table: Table, decorrelation_cells: int) -> None:
    """Two fields of 320 x 320; 190 cells need a padding of about 1280 (goal: 0.15 s)."""
    generator = np.random.default_rng(0)
    draw_s: list[float] = []

    def draw() -> tuple[ShadowField, ShadowField]:
        begun = perf_counter()
        pair = shadow_field_pair_db((CELLS, CELLS), 1.0, 4.0, decorrelation_cells, generator)
        draw_s.append(perf_counter() - begun)
        return pair

    first, _ = benchmark.pedantic(draw, rounds=ROUNDS, warmup_rounds=1)
    table.add("two fields", first.padding[0], draw_s[-ROUNDS:])
    assert first.values_db.shape == (CELLS, CELLS)
