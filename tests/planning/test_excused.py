"""What is said of steps that miss the bound."""

from __future__ import annotations

from dataclasses import replace

from planopt.planning.certificate import MOST_EXCUSED, Certificate, excused_in_words

PROOF = Certificate(1.0, 0.5, 0.0, None, "exact")
PRICED = replace(PROOF, relaxed_steps=(1, 3), relaxation_db=(0.5, 2.0), path_cost_m=8.0)
PRICED = replace(PRICED, best_cost_m=7.5)
FAR = replace(PROOF, relaxed_steps=(2,), relaxation_db=(1.25,), best_margin_db=(-0.75,))


def test_a_plan_tells_of_all_its_steps():
    """By how much each misses the bound, and what the price of it was compared with."""
    first, second = excused_in_words([PRICED])
    assert first == (
        "step 1 misses p_min by 0.50 dB: the way costs 8.0 m, the cheapest that the verifier "
        "found 7.5 m"
    )
    assert second.startswith("step 3 misses p_min by 2.00 dB")
    assert excused_in_words([FAR]) == [
        "step 2 misses p_min by 1.25 dB: the best place found within reach misses it by 0.75 dB"
    ]


def test_a_run_tells_of_the_steps_that_were_driven():
    """The first of each plan; of many the first, and how many more."""
    lines = excused_in_words([PROOF, PRICED, FAR, PRICED])
    assert [line.split(" misses")[0] for line in lines] == ["step 2", "step 4"]
    many = excused_in_words([PRICED] * (MOST_EXCUSED + 3))
    assert len(many) == MOST_EXCUSED + 1 and many[-1] == "and 3 more steps"
    assert excused_in_words([PROOF, FAR]) == []


def test_nothing_is_made_up():
    """Where the verifier found a place that keeps the bound, or objects, no excuse is given."""
    kept = replace(FAR, best_margin_db=(0.25,))
    assert excused_in_words([kept])[0].endswith("nothing excuses it")
    refused = replace(FAR, best_margin_db=(), reasons=("too far",))
    assert excused_in_words([refused])[0].endswith("nothing excuses it")
    slack = replace(FAR, best_margin_db=())
    assert excused_in_words([slack])[0].endswith("within constraints.slack_max_db")
