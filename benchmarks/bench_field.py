"""Exact shadowing fields against the length of the torus that they need."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import pytest
from conftest import Table
from pytest_benchmark.fixture import BenchmarkFixture

from planopt.channel import shadow_field_db
from planopt.channel.shadow_fields import ShadowField

CELLS = 320
ROUNDS = 7


@pytest.mark.parametrize("decorrelation_cells", [20, 150, 190])
def test_field(benchmark: BenchmarkFixture, table: Table, decorrelation_cells: int) -> None:
    """A field of 320 x 320; 190 cells need a padding of about 1280 (goal: 0.15 s)."""
    generator = np.random.default_rng(0)
    draw_s: list[float] = []

    def draw() -> ShadowField:
        begun = perf_counter()
        field = shadow_field_db((CELLS, CELLS), 1.0, 4.0, decorrelation_cells, generator)
        draw_s.append(perf_counter() - begun)
        return field

    first = benchmark.pedantic(draw, rounds=ROUNDS, warmup_rounds=1)
    table.add("field", first.padding[0], draw_s[-ROUNDS:])
    assert first.values_db.shape == (CELLS, CELLS)
