"""The way to a goal under each rule of connectivity: who crosses a gap, who may, who is slack."""

from dataclasses import replace
from time import process_time

import numpy as np
import pytest
from scenes import bad_band, belief_of, small_problem

from planopt import ConnectivityRule, NoPlanError, Verdict
from planopt.planning.explain.changes import EXPLAINED_S, Trials
from planopt.planning.explain.explain import explain_blocked
from planopt.planning.plan import History
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene

GAP = bad_band(17.0, 23.0)
"""Across the whole workspace, three steps wide."""
START = (11.0, 15.0)


def ruled(p_min, rule, **settings):
    """The hand-made problem before the gap under a rule."""
    problem = small_problem(start_m=START, horizon=10, **settings)
    return replace(problem, constraints=replace(problem.constraints, p_min=p_min, rule=rule))


def planned(problem, **history):
    planner = ReachPlanner(problem, build_scene(problem))
    return planner.plan(belief_of(problem, GAP), np.array(START), None, History(**history))


@pytest.mark.parametrize(
    ("p_min", "rule", "may_cross"),
    [
        (0.95, ConnectivityRule("each_step", (2.0, 5.0, 9.0)), True),
        (0.8, ConnectivityRule("average"), True),
        (0.99, ConnectivityRule("average"), False),
        (0.8, ConnectivityRule("joint"), False),
        (0.9, ConnectivityRule("outage", outage_max_m=8.0), True),
        (0.9, ConnectivityRule("outage", outage_max_s=1.0), False),
        (0.0, ConnectivityRule("data", data_mbit=30.0, deadline_s=50.0, rate_mbit_s=1.0), True),
        (0.9, ConnectivityRule("data", data_mbit=30.0, deadline_s=50.0, rate_mbit_s=1.0), True),
        (0.0, ConnectivityRule("data", data_mbit=49.0, deadline_s=50.0, rate_mbit_s=1.0), False),
    ],
)
@pytest.mark.parametrize("planner", ["auto", "lattice"])
def test_gap_is_crossed_and_the_rule_is_judged(p_min, rule, may_cross, planner):
    """All are on the other side, as nothing leads round; those whose rule forbids it say so."""
    plan = planned(ruled(p_min, rule, planner=planner))
    assert plan.positions_m[-1, 0] > 23.0
    assert (plan.verdict is Verdict.VERIFIED) == may_cross
    assert plan.certificate.rule.connectivity == rule.connectivity
    assert bool(plan.certificate.reasons) != may_cross


@pytest.mark.parametrize("planner", ["auto", "lattice"])
@pytest.mark.parametrize("rule", [ConnectivityRule(slack_max_db=0.0), ConnectivityRule("joint")])
def test_the_rule_is_kept_where_a_way_round_does(rule, planner):
    """A gap that the workspace leaves a way round is not crossed by a rule that forbids it."""
    problem = ruled(0.8, rule, planner=planner)
    power = bad_band(17.0, 23.0, open_above_m=19.0)
    plan = ReachPlanner(problem, build_scene(problem)).plan(
        belief_of(problem, power), np.array(START)
    )
    assert plan.verdict is Verdict.VERIFIED
    assert plan.positions_m[:, 1].max() > 18.0
    assert (plan.connectivity[1:] >= 0.5).all()


@pytest.mark.parametrize("planner", ["auto", "lattice"])
def test_a_hard_bound_is_refused_at_once(planner):
    """Where nothing keeps it, with the place of the hole and its length."""
    # Readings every 2 m are low at 19 m and 21 m.
    with pytest.raises(NoPlanError, match=r"coverage hole of [45] m that begins at \(1[89]\."):
        planned(ruled(0.9, ConnectivityRule(slack_max_db=0.0), planner=planner))


def test_polish_is_no_worse_than_the_lattice():
    """Nor on average and with outages, which leave it room."""
    for p_min, rule in (
        (0.8, ConnectivityRule("average")),
        (0.9, ConnectivityRule("outage", outage_max_m=8.0)),
    ):
        plan = planned(ruled(p_min, rule))
        assert plan.objective <= plan.lattice_objective


def test_history_decides_what_is_left():
    """Early outages forbid the gap, an early credit allows it."""
    problem = ruled(0.9, ConnectivityRule("average"))
    good = planned(problem, steps=40, connected_steps=40)
    poor = planned(problem, steps=40, connected_steps=36)
    assert good.verdict is Verdict.VERIFIED and poor.verdict is Verdict.VIOLATED


def test_slack_opens_a_gap():
    """As far as it is allowed; the certificate reports it."""
    with pytest.raises(NoPlanError):
        planned(ruled(0.9, ConnectivityRule(slack_max_db=5.0)))
    soft = planned(ruled(0.9, ConnectivityRule(slack_max_db=60.0)))
    assert soft.positions_m[-1, 0] > 23.0
    assert soft.verdict is Verdict.VERIFIED
    assert 0.0 < soft.certificate.rule.slack_db <= 60.0


def test_what_would_open_a_hard_bound():
    """Each change by itself, no looser than needed: 5 % less opens nothing."""
    problem = ruled(0.9, ConnectivityRule(slack_max_db=0.0))
    scene, belief = build_scene(problem), belief_of(problem, GAP)

    def solve_again(changed):
        try:
            return ReachPlanner(changed, scene).plan(belief, np.array(START))
        except NoPlanError:
            return None

    trials = Trials(solve_again, process_time() + EXPLAINED_S)
    found = explain_blocked(problem, scene, belief.posteriors, trials)
    assert len({each.constraint for each in found}) == len(found)
    by_key = {each.constraint: each for each in found}
    lower, slack = by_key["stations[0].threshold_dbm"], by_key["constraints.slack_max_db"]
    assert slack.relaxed_value == pytest.approx(-80.0 - lower.relaxed_value, abs=0.05)
    rule = ConnectivityRule(slack_max_db=0.95 * slack.relaxed_value)
    assert solve_again(ruled(0.9, rule)) is None
    assert trials.is_verified(ruled(0.9, replace(rule, slack_max_db=slack.relaxed_value)))
