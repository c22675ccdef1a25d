"""Plans of coupled terms beside every way of a few steps in evenly spaced directions."""

from itertools import product

import numpy as np
import pytest
from terms_scene import CONNECT, LEARNING, TRACKING, context_of, scorer_of, terms_problem

from planopt import Verdict
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.world import inside_bounds, swept_clearance_m

HEADINGS, STEPS = 8, 3
PATH = {"kind": "mapping", "form": "path", "variance_threshold_db2": 2.0, "closeness_per_m": 0.02}


def enumerated_best(context, scorer, ground):
    """The largest worth of all ways at full speed that are clear."""
    problem = context.problem
    angle = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
    step = problem.step_length_m * np.column_stack([np.cos(angle), np.sin(angle)])
    best = -np.inf
    for choice in product(range(HEADINGS), repeat=STEPS):
        path = context.position_m + np.vstack([np.zeros(2), np.cumsum(step[list(choice)], axis=0)])
        clear = swept_clearance_m(ground.index, path).min() >= problem.constraints.clearance_m
        if clear and inside_bounds(problem.workspace, path).all():
            best = max(best, scorer.objective(path[1:]))
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
    context, belief = context_of(terms_problem(term, horizon=STEPS))
    scorer, ground = scorer_of(context, belief)
    plan = HorizonPlanner(context.problem, ground).plan(context, scorer)
    assert plan.verdict is Verdict.VERIFIED
    best = enumerated_best(context, scorer, ground)
    assert np.isfinite(best)
    assert plan.objective >= best - 1e-4 * abs(best)
