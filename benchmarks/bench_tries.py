"""Steps of `fig4` in the form that tries places, against the additive form, in one run.

The form `recourse` compares hundreds of places a step where the additive form climbs one path. The
aim is at most three times its time, for the whole loop of three robots (``loop``) and for planning
alone (``planning``); the lines below the table have the ratios. Steps of both are driven in turn,
and of each step the least CPU time counts. What of a step grows with the number of measurements is
the verifier's exact prediction of one path, and the error over the workspace that runs record.
"""

from __future__ import annotations

from dataclasses import replace
from time import process_time

import numpy as np
import pytest
from conftest import Table
from pytest_benchmark.fixture import BenchmarkFixture
from tracking_averages import with_setting

from planopt import Plan, Problem, load, simulate
from planopt.planning.stepping import Stepper

FORMS = ("additive", "recourse")
STEPS = 13
"""The first one builds lattices and solvers, and is not timed."""

DRIVES = 3
SEED = 3


@pytest.mark.parametrize("count", [102, 1000])
@pytest.mark.parametrize("horizon", [10, 20])
def test_step_with_tries(
    benchmark: BenchmarkFixture, table: Table, horizon: int, count: int
) -> None:
    """Both forms verify every plan."""
    problems = {form: _problem(form, horizon, count) for form in FORMS}
    found: dict[tuple[str, str], list[list[float]]] = {}

    def drive_both() -> None:
        for form, problem in problems.items():
            loop_s, planning_s = _drive(problem)
            found.setdefault(("loop", form), []).append(loop_s)
            found.setdefault(("planning", form), []).append(planning_s)

    benchmark.pedantic(drive_both, rounds=DRIVES)
    least = {key: np.min(times, axis=0) for key, times in found.items()}
    for (part, form), times in least.items():
        table.add(f"fig4, {part}, {form}, N = {horizon}", count, times.tolist())
    for part in ("loop", "planning"):
        additive, recourse = (float(np.median(least[part, form])) for form in FORMS)
        table.note(
            f"fig4, N = {horizon}, {count} measurements: {part} with tries "
            f"{recourse / additive:.2f} times that of the additive form"
        )


def _problem(form: str, horizon: int, count: int) -> Problem:
    problem = with_setting(load("fig4"), f"{form}:{horizon}", "trace")
    measured = replace(problem.channel.measurements, count=count)
    return replace(
        problem,
        channel=replace(problem.channel, measurements=measured),
        planner=replace(problem.planner, max_steps=STEPS),
    )


def _drive(problem: Problem) -> tuple[list[float], list[float]]:
    """CPU seconds of each step but the first, and of all robots' planning in it."""
    ends: list[float] = []
    planning_s: list[float] = []
    plan = Stepper.plan

    def timed(stepper: Stepper) -> list[Plan]:
        begun = process_time()
        plans = plan(stepper)
        planning_s.append(process_time() - begun)
        return plans

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Stepper, "plan", timed)
        run = simulate(problem, seed=SEED, on_step=lambda _: ends.append(process_time()))
    assert run.verified_rate == 1.0
    return np.diff(ends).tolist(), planning_s[1:]
