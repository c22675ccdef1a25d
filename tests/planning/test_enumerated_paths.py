"""Plans of coupled terms beside every way of a few steps in evenly spaced directions."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from terms_scene import CONNECT, LEARNING, TRACKING, judge_of, situation_of, terms_problem

from planopt import Verdict
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.world import inside_bounds, swept_clearance_m

HEADINGS, STEPS = 8, 3
PATH = {"kind": "mapping", "form": "path", "variance_threshold_db2": 2.0, "closeness_per_m": 0.02}


def enumerated_best(situation, judge, ground):
    """The largest worth of all ways at full speed that are clear."""
    problem = situation.problem
    angle = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
    step = problem.step_length_m * np.column_stack([np.cos(angle), np.sin(angle)])
    best = -np.inf
    for choice in product(range(HEADINGS), repeat=STEPS):
        path = situation.position_m + np.vstack(
            [np.zeros(2), np.cumsum(step[list(choice)], axis=0)]
        )
        clear = swept_clearance_m(ground.index, path).min() >= problem.constraints.clearance_m
        if clear and inside_bounds(problem.workspace, path).all():
            best = max(best, judge.objective(path[1:]))
    return best


@pytest.mark.parametrize(
    "term",
    [
        *[{**LEARNING, "criterion": kind} for kind in "DTAV"],
        {"kind": "mapping", "form": "information"},
        {"kind": "mapping", "form": "average"},
        PATH,
        TRACKING,
        CONNECT,
    ],
    ids=str,
)
def test_no_enumerated_way_is_worth_more(term):
    """Of five hundred, valued from all measurements."""
    situation, belief = situation_of(terms_problem(term, horizon=STEPS))
    judge, ground = judge_of(situation, belief)
    plan = HorizonPlanner(situation.problem, ground).plan(situation, judge)
    assert plan.verdict is Verdict.VERIFIED
    best = enumerated_best(situation, judge, ground)
    assert np.isfinite(best)
    assert plan.objective >= best - 1e-4 * abs(best)
