"""The study of tracking over whole runs, cut short: what it drives, and what it prints."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from planopt import load, simulate

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(autouse=True)
def study(monkeypatch):
    """The study's module."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    return import_module("tracking_averages")


@pytest.fixture(scope="module")
def fig4():
    """Four steps of the outdoor scene."""
    problem = load("fig4")
    return replace(problem, planner=replace(problem.planner, max_steps=4))


def test_a_setting_is_what_it_says(fig4, study):
    """Form, horizon, planner and packets; what is left out is the problem's."""
    problem = study.with_setting(fig4, "recourse:3:lattice:estimates", "trace")
    assert problem.terms[0].form == "recourse" and problem.planner.horizon == 3
    assert (problem.planner.name, problem.targets[0].packets) == ("lattice", "estimates")
    assert study.with_setting(fig4, "additive:1", "trace").planner.name == fig4.planner.name


def test_rows_are_those_of_runs(fig4, study):
    """The same numbers as a simulation's, and a table that compares seed by seed."""
    rows = [
        study.run_row(fig4, each, seed, "trace")
        for each in ("additive:1", "recourse:2:lattice")
        for seed in (0, 1)
    ]
    run = simulate(study.with_setting(fig4, "additive:1", "trace"), seed=1)
    assert rows[1].mean_m2 == run.metrics["time_averaged_trace_p"]
    lines = study.table(fig4, rows, "trace")
    first, second = (line.split() for line in lines[1:])
    assert first[:2] == ["additive:1", "2"] and first[10] == "+0.0000"
    means = np.array([row.mean_m2 for row in rows]).reshape(2, 2)
    assert float(second[2]) == pytest.approx(means[1].mean(), abs=1e-4)
    assert float(second[-1]) == pytest.approx(means[1].mean() / means[0].mean(), abs=1e-3)
    assert first[6] == "0"
