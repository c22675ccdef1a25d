"""A thousand steps of a pursuit on 256 x 256 motes, and small versions of ``pursuit_study.py``."""

from __future__ import annotations

from functools import partial
from time import perf_counter

import numpy as np
import pytest
from conftest import Table
from pursuit_study import captures, varied
from pytest_benchmark.fixture import BenchmarkFixture

from planopt import compare
from planopt.pursuit import (
    Arena,
    DriveToReport,
    Evader,
    Fleeing,
    Policy,
    Pursuer,
    Pursuit,
    RecedingHorizon,
    Scene,
    SnapshotRecords,
    SnapshotService,
    StraightMotion,
    Track,
    simulate_pursuit,
    snapshot,
)

STEPS = 1000
SERVICE = SnapshotService(levels=8, mote_spacing_m=1.0, frame_s=0.05, bits_per_axis=5)
POLICIES = {
    "drive": DriveToReport,
    "receding 10": partial(RecedingHorizon, horizon=10, plan_step_s=2.0, manoeuvre_s=60.0),
}


@pytest.mark.parametrize("name", POLICIES)
def test_thousand_steps(benchmark: BenchmarkFixture, table: Table, name: str) -> None:
    """Nobody is caught in a thousand steps (goal: 10 s, maps of all motes included)."""
    durations_s: list[float] = []

    def run() -> Pursuit:
        begun = perf_counter()
        pursuit = simulate_pursuit(_scene(POLICIES[name]), np.random.default_rng(0))
        for step in range(STEPS):
            known = Track(pursuit.times_s[: step + 1], pursuit.evaders_m[0, : step + 1])
            snapshot(SERVICE, known, float(pursuit.times_s[step])).level_map()
        durations_s.append(perf_counter() - begun)
        return pursuit

    pursuit = benchmark.pedantic(run, rounds=3, warmup_rounds=0)
    table.add(f"1,000 steps, {name}", SERVICE.motes_per_side**2, durations_s)
    assert len(pursuit.times_s) == STEPS + 1
    assert min(durations_s) < 10.0


def test_captures(benchmark: BenchmarkFixture, capsys: pytest.CaptureFixture[str]) -> None:
    """Six drawn pursuits, one of each kind of evader, all end in time."""
    benchmark.pedantic(lambda: captures(0, 6), rounds=1)
    assert "6 pursuits: 0 not captured, 0 later than promised" in capsys.readouterr().out


def test_planners(benchmark: BenchmarkFixture) -> None:
    """A unicycle that loses reports catches a zigzagging evader by both planners."""
    problem = varied("pursuit_fleeing", {"kind": "zigzag", "period_s": 15.0}, 0.5, 0.3)
    found = benchmark.pedantic(
        lambda: compare(problem, (2,), planners=("drive", "receding"), seeds=1), rounds=1
    )
    assert [run.outcome for run in found.runs] == ["captured"] * 2


def _scene(policy: Policy) -> Scene:
    """A slow pursuer far from an evader that flees."""
    return Scene(
        (Pursuer(np.array([5.0, 5.0]), StraightMotion(0.3), policy),),
        (Evader(np.array([200.0, 200.0]), 0.1, Fleeing()),),
        SnapshotRecords(SERVICE),
        1.0,
        0.2,
        STEPS,
        Arena((0.0, 0.0, 256.0, 256.0)),
    )
