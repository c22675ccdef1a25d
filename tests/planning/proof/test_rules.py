"""The verifier under each rule: closed forms, sampled channels, and what has happened before."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from rules_scene import hand_made
from scenes import THRESHOLD_DBM, bad_band, bad_everywhere, belief_of, good_everywhere, verified
from scipy.special import ndtr
from scipy.stats import binomtest

from planopt import Verdict
from planopt.channel import joint_connectivity, joint_prediction, sample_power
from planopt.channel.joint import longest_run
from planopt.planning.plan import History, data_of_steps_mbit, history_of
from planopt.planning.proof.connectivity_rules import ACCURACY, SEED, joint_result, share_at_least
from planopt.planning.proof.rule import rule_of
from planopt.world import index_obstacles

ALONG = np.array([[16.0, 15.0], [18.0, 15.0], [20.0, 15.0], [22.0, 15.0], [24.0, 15.0]])
GAP = bad_band(19.0, 23.0, open_above_m=20.0)
"""Steps 2 and 3 of `ALONG` are in it; it ends above the path."""


def faint(positions_m: np.ndarray) -> np.ndarray:
    """A little above the threshold everywhere, less so to the right."""
    return THRESHOLD_DBM + 1.0 - 0.02 * positions_m[:, 0]


def assessed(problem, power_at, path_m=ALONG, **history):
    """The judgement of a path, and the channel."""
    posterior = belief_of(problem, power_at).posterior
    index = index_obstacles(problem.workspace)
    past = History(**history)
    return verified(problem, index, posterior, path_m[0], path_m, history=past), posterior


def chances(posterior, path_m=ALONG):
    """P(connected) after each step, by the normal distribution."""
    power = posterior.predict(path_m[1:])
    return ndtr((power.mean_db - THRESHOLD_DBM) / power.deviation_db)


def test_stated_times():
    """A gap is no matter but at a stated time of the run; then the reason names the step."""
    kept, _ = assessed(hand_made("each_step", connected_times_s=(1.0, 4.0)), GAP)
    assert kept.verdict is Verdict.VERIFIED
    assert kept.certificate.relaxed_steps == ()
    assert (kept.certificate.rule.achieved, kept.certificate.rule.required) == (2.0, 2.0)
    missed, _ = assessed(hand_made("each_step", connected_times_s=(1.0, 3.0)), GAP)
    assert missed.verdict is Verdict.VIOLATED
    assert missed.certificate.relaxed_steps == (3,)
    assert "step 3" in missed.certificate.reasons[0]
    problem = hand_made("each_step", connected_times_s=(8.0, 8.0, 99.0))
    assert rule_of(problem).counted(History(steps=6), 4).tolist() == [False, True, False, False]
    assert rule_of(problem).counted(History(steps=8), 4).sum() == 0
    assert assessed(problem, GAP, steps=6)[0].verdict is Verdict.VIOLATED
    assert assessed(problem, GAP, steps=4)[0].verdict is Verdict.VERIFIED


def test_average_counts_the_run_so_far():
    """(connected steps + sum of chances) / all steps, against p_min."""
    problem = hand_made("average", p_min=0.7)
    judgement, posterior = assessed(problem, faint, steps=6, connected_steps=5)
    mean = (5.0 + chances(posterior).sum()) / 10.0
    assert judgement.certificate.rule.achieved == pytest.approx(mean, abs=1e-12)
    for p_min, verdict in ((mean - 1e-4, Verdict.VERIFIED), (mean + 1e-4, Verdict.VIOLATED)):
        required = hand_made("average", p_min=p_min)
        again, _ = assessed(required, faint, steps=6, connected_steps=5)
        assert again.verdict is verdict
    assert "on average" in again.certificate.reasons[0]


def test_joint_is_the_share_of_sampled_channels_that_connect_throughout():
    """A lower bound near it: powers are drawn together, and the integral's error is taken off."""
    judgement, posterior = assessed(hand_made("joint", p_min=0.5), faint)
    drawn = sample_power(posterior, ALONG[1:], 40_000, np.random.default_rng(7))
    share = float((drawn >= THRESHOLD_DBM).all(axis=1).mean())
    error = 3.0 * np.sqrt(share * (1.0 - share) / len(drawn))
    result = judgement.certificate.rule
    assert share - error - 3e-3 < result.achieved < share + error
    assert result.achieved < chances(posterior).min()
    for p_min, verdict in ((share - 0.02, Verdict.VERIFIED), (share + 0.02, Verdict.VIOLATED)):
        assert assessed(hand_made("joint", p_min=p_min), faint)[0].verdict is verdict
    problem = hand_made("joint", p_min=0.5)
    prediction = joint_prediction(belief_of(problem, faint).posterior, ALONG[1:])
    found = joint_connectivity(prediction, THRESHOLD_DBM, np.random.default_rng(SEED), ACCURACY)
    result = joint_result(prediction, THRESHOLD_DBM, 0.5)
    assert found.exact.error > 0.0
    assert result.achieved == found.exact.value - found.exact.error
    assert "integral" in result.method


def test_outage_in_metres_and_seconds():
    """Exactly the missed steps in a row are allowed; one that has begun counts if it goes on."""
    for key, unit, length in (("outage_max_m", "m", 4.0), ("outage_max_s", "s", 2.0)):
        kept, _ = assessed(hand_made("outage", **{key: length}), GAP)
        assert kept.verdict is Verdict.VERIFIED
        assert (kept.certificate.rule.achieved, kept.certificate.rule.unit) == (length, unit)
        missed, _ = assessed(hand_made("outage", **{key: length - 0.01}), GAP)
        assert missed.verdict is Verdict.VIOLATED
        assert key in missed.certificate.reasons[0]
    problem = hand_made("outage", outage_max_m=4.0)
    assert assessed(problem, GAP, outage_m=3.0, outage_steps=2)[0].verdict is Verdict.VERIFIED
    inside = ALONG + np.array([2.0, 0.0])
    going_on, _ = assessed(problem, GAP, inside, outage_m=3.0, outage_steps=2)
    assert going_on.certificate.rule.achieved == pytest.approx(7.0)
    assert going_on.verdict is Verdict.VIOLATED


def by_stretches(sizes, missed, before):
    """The largest sum over all stretches of missed steps, tried one by one."""
    best, count = 0.0, len(sizes)
    for first in range(count):
        for last in range(first, count):
            if missed[first : last + 1].all():
                head = before if first == 0 else 0.0
                best = max(best, head + sizes[first : last + 1].sum())
    return best


def test_longest_run_against_every_stretch():
    generator = np.random.default_rng(5)
    sizes, missed = generator.random((50, 8)), generator.random((50, 8)) < 0.6
    found = longest_run(sizes, missed, 0.7)
    for number in range(50):
        assert found[number] == pytest.approx(by_stretches(sizes[number], missed[number], 0.7))


OUTCOMES = (np.arange(16)[:, None] >> np.arange(4) & 1).astype(float)
"""Every outcome of four steps; ``(16, 4)``."""


def by_enumeration(probability, value):
    """The expectation of a value of outcomes (16,), were steps independent."""
    chance = np.where(OUTCOMES > 0, probability, 1.0 - probability).prod(axis=1)
    return float(chance @ value)


def least_chance(probability, event):
    """The least probability of an event over all joint laws with these marginals."""
    found = scipy.optimize.linprog(
        event.astype(float),
        A_eq=np.vstack([OUTCOMES.T, np.ones(16)]),
        b_eq=np.append(probability, 1.0),
    )
    return float(found.fun)


DATA = {"data_mbit": 30.0, "deadline_s": 20.0, "rate_mbit_s": 2.0}


@pytest.mark.parametrize("form", ["each_step", "average", "joint", "data", "outage"])
def test_achieved_is_what_enumeration_says(form):
    """For many plans at once, against sums over all outcomes of four steps."""
    keys = {"data": DATA, "outage": {"outage_max_s": 2.0}}.get(form, {})
    rule = rule_of(hand_made(form, p_min=0.6, **keys))
    past = History(steps=6, connected_steps=5, outage_steps=1, outage_m=2.0)
    probability = np.random.default_rng(4).uniform(0.3, 1.0, (3, 2, 4))
    found = rule.valued(probability, past)
    assert found.shape == (3, 2)
    for index in np.ndindex(3, 2):
        one = probability[index]
        expected = {
            "each_step": lambda p=one: min(p),
            "average": lambda p=one: by_enumeration(p, (5.0 + OUTCOMES.sum(axis=1)) / 10.0),
            "data": lambda p=one: by_enumeration(p, 2.0 * OUTCOMES.sum(axis=1)),
            "outage": lambda p=one: -by_stretches(np.ones(4), p < 0.6, 1.0),
            "joint": lambda p=one: least_chance(p, OUTCOMES.all(axis=1)),
        }[form]()
        value = max(found[index], 0.0) if form == "joint" else found[index]
        assert value == pytest.approx(expected, abs=1e-9)
        assert float(rule.valued(one, past)) == pytest.approx(found[index])


@pytest.mark.parametrize("form", ["joint", "data"])
def test_required_suffices_however_steps_correlate(form):
    """With the value that is required every joint law keeps p_min, and one has no more."""
    keys = {"data_mbit": 15.0, "deadline_s": 20.0, "rate_mbit_s": 1.0} if form == "data" else {}
    rule = rule_of(hand_made(form, p_min=0.7, **keys))
    needed = 4 if form == "joint" else 3
    required, past = rule.required(0.7, History(), 4), History()
    generator = np.random.default_rng(3)
    for _ in range(5):
        short = generator.dirichlet(np.ones(4))
        scale = (rule.achieved(np.ones(4), past) - required) / (
            rule.achieved(np.ones(4), past) - rule.achieved(1.0 - short, past)
        )
        probability = 1.0 - scale * short
        assert rule.achieved(probability, past) == pytest.approx(required)
        least = least_chance(probability, OUTCOMES.sum(axis=1) >= needed)
        assert least >= 0.7 - 1e-9
        assert form == "data" or least == pytest.approx(0.7)


def test_data_must_keep_pace_with_the_deadline():
    """Expected data of four of twenty seconds against a fifth of what is asked."""
    rule = {"data_mbit": 30.0, "deadline_s": 20.0, "rate_mbit_s": 2.0}
    judgement, posterior = assessed(hand_made("data", p_min=0.0, **rule), faint)
    result = judgement.certificate.rule
    assert result.achieved == pytest.approx(2.0 * chances(posterior).sum())
    assert result.required == pytest.approx(6.0)
    assert judgement.verdict is Verdict.VIOLATED
    assert "data_mbit" in judgement.certificate.reasons[0]
    # Two seconds before the deadline only two steps count, and all that is missing is asked.
    late = {"steps": 18, "delivered_mbit": 29.0}
    ending, _ = assessed(hand_made("data", p_min=0.0, **rule), faint, **late)
    assert ending.certificate.rule.required == pytest.approx(1.0)
    assert ending.certificate.rule.achieved == pytest.approx(2.0 * chances(posterior)[:2].sum())
    after, _ = assessed(hand_made("data", p_min=0.0, **rule), bad_everywhere, steps=20)
    assert (after.verdict, after.certificate.rule.required) == (Verdict.VERIFIED, 0.0)


def test_data_with_a_probability():
    """A lower bound, near, of the share of sampled channels with three of four steps connected."""
    rule = {"data_mbit": 15.0, "deadline_s": 20.0, "rate_mbit_s": 1.0}
    judgement, posterior = assessed(hand_made("data", p_min=0.5, **rule), faint)
    drawn = sample_power(posterior, ALONG[1:], 40_000, np.random.default_rng(8))
    share = float(((drawn >= THRESHOLD_DBM).sum(axis=1) >= 3).mean())
    result = judgement.certificate.rule
    assert (result.unit, result.required) == ("probability", 0.5)
    assert share - 0.03 < result.achieved < share + 0.005
    for p_min, verdict in ((share - 0.04, Verdict.VERIFIED), (share + 0.04, Verdict.VIOLATED)):
        again, _ = assessed(hand_made("data", p_min=p_min, **rule), faint)
        assert again.verdict is verdict
    assert "constraints.p_min" in again.certificate.reasons[0]
    # Two of three steps are asked for; the path ends with two in the gap.
    rule["data_mbit"] = 13.2
    assert assessed(hand_made("data", **rule), GAP, ALONG[:4])[0].verdict is Verdict.VIOLATED
    rule["data_mbit"] = 15.0
    done, _ = assessed(
        hand_made("data", p_min=0.99999, **rule), bad_everywhere, delivered_mbit=15.0
    )
    assert done.verdict is Verdict.VERIFIED


def test_numbers_behind_the_rules():
    """Clopper and Pearson's share, steps cut by the deadline, and a track counted by hand."""
    for count in (0, 1, 700, 1000):
        interval = binomtest(count, 1000, alternative="greater").proportion_ci(0.99)
        assert share_at_least(count, 1000) == pytest.approx(interval.low)
    problem = hand_made("data", data_mbit=1.0, deadline_s=2.5, rate_mbit_s=4.0)
    assert data_of_steps_mbit(problem, 0, 4).tolist() == [4.0, 4.0, 2.0, 0.0]
    assert data_of_steps_mbit(problem, 2, 2).tolist() == [2.0, 0.0]
    problem = hand_made("data", data_mbit=1.0, deadline_s=3.5, rate_mbit_s=2.0)
    track = np.array([[0, 0], [1, 0], [1, 2], [4, 2], [4, 2.5]], dtype=float)
    past = history_of(problem, track, np.array([True, True, False, False]))
    assert past == History(4, 2, 2, 3.5, 4.0)
    assert history_of(problem, track[:1], np.zeros(0, dtype=bool)) == History()
    never = history_of(problem, track, np.zeros(4, dtype=bool))
    assert (never.outage_steps, never.outage_m) == (4, 6.5)


@pytest.mark.parametrize("form", ["average", "joint", "data", "outage"])
def test_slack_is_the_least_lowering_of_the_threshold(form):
    """The rule holds at a threshold lower by the slack that is reported, and not at one higher."""
    rule = {
        "average": {"p_min": 0.95},
        "joint": {"p_min": 0.9},
        "data": {"p_min": 0.0, "data_mbit": 3.8, "deadline_s": 4.0, "rate_mbit_s": 1.0},
        "outage": {"p_min": 0.95, "outage_max_s": 0.0},
    }[form]
    hard = hand_made(form, **rule)
    assert assessed(hard, faint)[0].verdict is Verdict.VIOLATED
    slack_db = assessed(hand_made(form, slack_max_db=20.0, **rule), faint)[
        0
    ].certificate.rule.slack_db
    assert 0.0 < slack_db < 20.0

    def verdict_at(lower_db):
        station = replace(hard.stations[0], threshold_dbm=THRESHOLD_DBM - lower_db)
        return assessed(replace(hard, stations=(station,)), faint)[0].verdict

    assert verdict_at(slack_db + 1e-3) is Verdict.VERIFIED
    assert verdict_at(slack_db - 1e-3) is Verdict.VIOLATED
    for limit, verdict in ((0.9, Verdict.VIOLATED), (1.1, Verdict.VERIFIED)):
        bounded = hand_made(form, slack_max_db=limit * slack_db, **rule)
        assert assessed(bounded, faint)[0].verdict is verdict


def test_slack_of_single_steps_is_bounded_and_replaces_the_excuse():
    """Hard: also where nothing within reach keeps the bound. Soft: within the slack, reported."""
    hopeless, _ = assessed(hand_made("each_step", slack_max_db=0.0), bad_everywhere)
    assert hopeless.verdict is Verdict.VIOLATED
    assert "misses constraints.p_min" in hopeless.certificate.reasons[0]
    soft, posterior = assessed(hand_made("each_step", slack_max_db=30.0), GAP)
    power = posterior.predict(ALONG[1:])
    margins = power.mean_db - 1.2815515655446004 * power.deviation_db - THRESHOLD_DBM
    assert soft.verdict is Verdict.VERIFIED
    assert soft.certificate.relaxed_steps == (2, 3)
    assert soft.certificate.relaxation_db == pytest.approx((-margins[1], -margins[2]))
    assert soft.certificate.rule.slack_db == pytest.approx(-margins.min())
    tight, _ = assessed(hand_made("each_step", slack_max_db=-margins.min() - 0.01), GAP)
    assert tight.verdict is Verdict.VIOLATED


def test_whole_rules_are_kept_where_power_is_good():
    for form, rule in (
        ("average", {}),
        ("joint", {}),
        ("outage", {"outage_max_m": 0.0}),
        ("data", {"p_min": 0.0, "data_mbit": 4.0, "deadline_s": 5.0, "rate_mbit_s": 1.0}),
    ):
        judgement, _ = assessed(hand_made(form, slack_max_db=3.0, **rule), good_everywhere)
        assert judgement.verdict is Verdict.VERIFIED
        assert judgement.certificate.rule.slack_db == 0.0
