"""A plan and a run of the open field, solved once for all tests of their files."""

from dataclasses import replace
from pathlib import Path

import pytest

from planopt import Run, Solution, load, simulate, solve


@pytest.fixture(scope="session")
def solution() -> Solution:
    """A verified plan of six steps beside the wall."""
    return solve(load("open_field"), horizon=6)


@pytest.fixture(scope="session")
def simulation() -> Run:
    """A run of eight steps, some of which measured."""
    problem = load("open_field")
    short = replace(problem, planner=replace(problem.planner, max_steps=8))
    return simulate(short, horizon=4, seed=1)


@pytest.fixture
def plan_folder(tmp_path: Path, solution: Solution) -> Path:
    solution.save(tmp_path / "plan")
    return tmp_path / "plan"


@pytest.fixture
def run_folder(tmp_path: Path, simulation: Run) -> Path:
    simulation.save(tmp_path / "run")
    return tmp_path / "run"
