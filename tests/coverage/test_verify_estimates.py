"""The verifier of estimates accepts those of the estimator and rejects altered ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import planopt
from planopt.coverage.verify import SignalModel, estimate_fault
from planopt.problems.tasks import problem_from
from planopt.tasks.coverage import faults


def test_altered_estimates_are_rejected() -> None:
    """A tenth of a standard deviation and a shifted position are faults at every checked step."""
    table = planopt.load("event_response").tables()
    table["control"]["duration_s"] = 90
    problem = problem_from(table, folder=Path(), file=None)
    result = planopt.simulate(problem, seed=2)
    run = result.value
    assert result.data["faults"] == [] == faults(result)
    small = replace(run, stds_m=run.stds_m / 10.0)
    assert len(faults(replace(result, value=small))) == 10
    shifted = replace(run, estimates_m=run.estimates_m + 0.5 * run.stds_m[..., None])
    assert len(faults(replace(result, value=shifted))) == 10
    louder = replace(run, readings=(run.readings[0] + [0.0, 0.0, 0.0, 2.0],))
    assert faults(replace(result, value=louder))


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("moves", [False, True])
def test_deviation_by_sampling(known: bool, moves: bool) -> None:
    """The recomputed standard deviation is that of estimates from many drawn readings."""
    rng, off = np.random.default_rng(4), 3.0
    turn = 2.0 * np.pi * np.arange(24) / 24
    places = off * np.stack((np.cos(turn), np.sin(turn)), axis=1)
    ages = np.tile([0.0, 1.0, 2.0], 8)
    model = SignalModel(0.3, 20.0, known, 4.0, 0.5 if moves else None)
    speed = np.array([0.2, -0.1]) if moves else np.zeros(2)
    away = ((places + ages[:, None] * speed) ** 2).sum(axis=1)
    clean = 20.0 / (away / 16.0 + 1.0)
    found = []
    for _ in range(60):
        noisy = clean + 0.3 * rng.standard_normal(24)
        # A wrong position far beyond its deviation: the message has the distance to the best one.
        words = estimate_fault(model, places, noisy, ages, np.array([1.0, 0.0]), 1e-6, True)
        assert words is not None and "m from the position" in words
        found.append(float(words.split()[3]) ** 2)
    # E |best - (1, 0)|^2 = 1 + std^2; the standard deviation is bounded from both sides.
    at = np.zeros(2)
    low = estimate_fault(model, places, clean, ages, at, 1e-3, True)
    assert low is not None
    std = float(low.split()[-2])
    assert np.mean(found) == pytest.approx(1.0 + std**2, abs=4.0 * std / np.sqrt(15.0))
    assert estimate_fault(model, places, clean, ages, at, 1.001 * std, True) is None
