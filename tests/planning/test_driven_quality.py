"""Plans of robots that cannot turn or stop at will, against other starts and themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motion_scene import DOUBLE, WHEELS, driven_problem, planned
from terms_scene import TRACKING

from planopt import load, solve
from planopt.planning.plan import Rung, Verdict
from planopt.planning.search.guess_search import Guess
from planopt.problems import problem_from_dict, problem_to_dict
from planopt.robots.dynamics import rolled_out

HORIZON = 20


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("target_m", [(30.0, 45.0), (10.0, 36.0)])
def test_plan_is_worth_as_much_as_from_random_starts(dynamics, target_m) -> None:
    """Far ahead, and where the best drive is far from the one that the search begins with."""
    problem = driven_problem(dynamics, TRACKING, horizon=HORIZON)
    problem = replace(problem, targets=(replace(problem.targets[0], start_m=target_m),))
    plan, situation, judge, planner = planned(problem)
    assert plan.verdict is Verdict.VERIFIED
    generator = np.random.default_rng(0)
    for _ in range(3):
        drift = 0.5 * generator.normal(size=2)
        turns = 0.1 * np.cumsum(generator.normal(size=(HORIZON, 2)), axis=0)
        way = judge.position_m + np.cumsum(drift + turns, axis=0)
        start = begun(dynamics, judge, dynamics.following(judge.state, way, 1.0))
        for _ in range(3):
            found = planner.cascade.refinement.candidates(situation, judge, start, Rung.PLAN)
            verified = [c for c in found if c.verdict is Verdict.VERIFIED]
            if not verified:
                break
            best = max(verified, key=lambda candidate: candidate.objective)
            assert plan.objective >= 0.98 * best.objective
            start = begun(dynamics, judge, best.drive.inputs)


def begun(dynamics, judge, inputs) -> Guess:
    """A start that drives these inputs."""
    drive = rolled_out(dynamics, judge.state, inputs, 1.0)
    path = drive.positions_m[1:]
    return Guess(path, judge.objective(path), 0.0, drive, clear=False)


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
def test_plan_is_settled(dynamics) -> None:
    """Polished again from itself, about its own sides of obstacles, it gains little."""
    plan, situation, judge, planner = planned(driven_problem(dynamics, TRACKING, horizon=HORIZON))
    again = begun(dynamics, judge, plan.drive.inputs)
    for candidate in planner.cascade.refinement.candidates(situation, judge, again, Rung.PLAN):
        if candidate.verdict is Verdict.VERIFIED:
            assert candidate.objective <= 1.01 * plan.objective


def test_a_curve_too_near_beside_its_chord_is_mended() -> None:
    """The boat's first polish comes 3 cm too near in stopping, where no chord does."""
    tables = problem_to_dict(load("harbour_track"))
    tables["objective"]["terms"][0]["form"] = "additive"
    boat = solve(problem_from_dict(tables), horizon=HORIZON, seed=6).plans[0]
    assert boat.verdict is Verdict.VERIFIED
    assert boat.rung is Rung.PLAN
    assert boat.polish_gain > 1.0
