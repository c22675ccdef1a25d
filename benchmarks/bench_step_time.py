"""One planning step of the closed loop against the number of measurements.

The step must not cost more than 1.5 times as much with 5,000 measurements as with 100. The table
at the end of the run has the ratios. 4,900 and 5,000 are on the two sides of the number up to which
the verifier uses every measurement. ``--benchmark-disable`` runs one step of each.
"""

from __future__ import annotations

import pytest
from conftest import Table
from pytest_benchmark.fixture import BenchmarkFixture
from scenes import Drive

from planopt import Verdict

HORIZON = 10
STEPS = 30


@pytest.mark.parametrize("count", [100, 300, 1000, 4900, 5000])
@pytest.mark.parametrize("cost_to_go", ["geodesic", "connected"])
def test_step(benchmark: BenchmarkFixture, table: Table, cost_to_go: str, count: int) -> None:
    """Refresh the map, search, polish and verify; the factor's update is timed apart."""
    drive = Drive(count, HORIZON, cost_to_go)
    plan = benchmark.pedantic(drive.step, setup=drive.learn, rounds=STEPS)
    table.add(f"step, {cost_to_go}", count, drive.step_s)
    table.add("update of the factor", count, drive.update_s)
    assert plan.verdict is Verdict.VERIFIED
