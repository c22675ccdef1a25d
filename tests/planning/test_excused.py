"""What is said of steps that miss the bound."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np

from planopt.planning.certificate import (
    MOST_EXCUSED,
    Certificate,
    excused_in_words,
    excused_steps,
    worst_of,
    worst_of_robots,
)

PROOF = Certificate(1.0, 0.5, 0.0, None, "exact")
PRICED = replace(PROOF, relaxed_steps=(1, 3), relaxation_db=(0.5, 2.0), path_cost_m=8.0)
PRICED = replace(PRICED, best_cost_m=7.5)
FAR = replace(PROOF, relaxed_steps=(2,), relaxation_db=(1.25,), best_margin_db=(-0.75,))


def said(proofs: list[Certificate]) -> list[str]:
    """The lines about their steps."""
    return excused_in_words(excused_steps(proofs))


def test_a_plan_tells_of_all_its_steps():
    """By how much each misses the bound, and what the price of it was compared with."""
    first, second = said([PRICED])
    assert first == (
        "step 1 misses p_min by 0.50 dB: the route costs 8.0 m, the cheapest that the verifier "
        "found 7.5 m"
    )
    assert second.startswith("step 3 misses p_min by 2.00 dB")
    assert said([FAR]) == [
        "step 2 misses p_min by 1.25 dB: the best place found within reach misses it by 0.75 dB"
    ]


def test_a_run_tells_of_the_steps_that_were_driven():
    """The first of each plan; of many the first, and how many more."""
    lines = said([PROOF, PRICED, FAR, PRICED])
    assert [line.split(" misses")[0] for line in lines] == ["step 2", "step 4"]
    many = said([PRICED] * (MOST_EXCUSED + 3))
    assert len(many) == MOST_EXCUSED + 1 and many[-1] == "and 3 more steps"
    assert said([PROOF, FAR]) == []


def test_nothing_is_made_up():
    """Where the verifier found a place that keeps the bound, or objects, no excuse is given."""
    kept = replace(FAR, best_margin_db=(0.25,))
    assert said([kept])[0].endswith("nothing excuses it")
    refused = replace(FAR, best_margin_db=(), reasons=("too far",))
    assert said([refused])[0].endswith("nothing excuses it")
    slack = replace(FAR, best_margin_db=())
    assert said([slack])[0].endswith("within constraints.slack_max_db")


def test_ways_that_the_verifier_cannot_compare_excuse_nothing():
    """Its grid has no path: infinite costs are in no excuse, no sum and no file."""
    for way_m, best_m in ((np.inf, np.inf), (np.inf, 7.0), (8.0, np.inf)):
        lost = replace(PRICED, path_cost_m=way_m, best_cost_m=best_m)
        assert lost.excess_m is None
        assert said([lost])[0].endswith("nothing excuses it")
        json.dumps([asdict(one) for one in excused_steps([lost])], allow_nan=False)
        worst = worst_of([lost, PRICED])
        assert (worst.path_cost_m, worst.best_cost_m) == (8.0, 7.5)


def test_merged_certificates_keep_the_dearest():
    """The plan that is most above the cheapest, and the step that cost most too much."""
    cheap = replace(PRICED, path_cost_m=90.0, best_cost_m=89.9, step_cost_m=6.0, step_excess_m=5.0)
    worst = worst_of([PROOF, PRICED, cheap])
    assert (worst.path_cost_m, worst.best_cost_m) == (8.0, 7.5)
    assert (worst.step_cost_m, worst.step_excess_m) == (6.0, 5.0)
    worst = worst_of([PROOF, FAR])
    assert (worst.path_cost_m, worst.step_cost_m, worst.step_excess_m) == (None, None, None)
    merged = worst_of_robots({"a": cheap, "b": PRICED})
    assert (merged.path_cost_m, merged.best_cost_m, merged.step_excess_m) == (8.0, 7.5, 5.0)
