"""Plans of the information objectives beside the best of many polished starts, in a small scene."""

from __future__ import annotations

import numpy as np
import pytest
from terms_scene import LEARNING, judge_of, situation_of, terms_problem

from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.plan import Rung, Verdict
from planopt.planning.search.fan_guesses import fan_paths, rough_clearance
from planopt.planning.search.guess_search import Guess


@pytest.mark.parametrize(
    "term",
    [
        LEARNING,
        {"kind": "mapping", "form": "information"},
        {"kind": "mapping", "form": "average"},
    ],
)
def test_plans_are_hardly_worse_than_the_best_of_starts(term):
    """Of 12 ways of a fan, in two seeded scenes; benchmarks/bench_information.py has the study."""
    shares = []
    for seed in range(2):
        situation, belief = situation_of(terms_problem(term), seed)
        judge, ground = judge_of(situation, belief)
        planner = HorizonPlanner(situation.problem, ground)
        plan = planner.plan(situation, judge)
        assert plan.verdict is Verdict.VERIFIED
        rough = rough_clearance(situation.problem, ground.index)
        best = plan.objective
        for path in fan_paths(situation, ground.index, rough, 5)[::10]:
            start = Guess(path, judge.objective(path), 0.0)
            for candidate in planner.cascade.refinement.candidates(
                situation, judge, start, Rung.PLAN
            ):
                if candidate.verdict is Verdict.VERIFIED:
                    best = max(best, candidate.objective)
        shares.append(plan.objective / best)
    assert np.mean(shares) >= 0.995
