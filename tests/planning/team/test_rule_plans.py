"""Planning, driving and checking under each rule of connectivity."""

from dataclasses import replace

import numpy as np
import pytest
from rules_scene import RULES, ruled_problem
from scipy.stats import binomtest
from terms_scene import LEARNING, TRACKING, context_of, scorer_of, terms_problem

from planopt import ConnectivityRule, Verdict
from planopt.channel import sample_power
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.refinement import RETURNED
from planopt.planning.solve import simulate, solve
from planopt.planning.values.objective_value import ObjectiveValue

SEED = 3


def free_plan():
    return solve(terms_problem(TRACKING), seed=SEED).plans[0]


@pytest.mark.parametrize("form", RULES)
def test_plan_keeps_a_rule_that_binds(form):
    """Verified, at a worth below that of the free plan, which breaks the rule; and polished."""
    plan = solve(ruled_problem(form), seed=SEED).plans[0]
    assert plan.verdict is Verdict.VERIFIED
    result = plan.certificate.rule
    assert result.missing <= 1e-7
    free = free_plan()
    assert plan.objective < free.objective
    problem = ruled_problem(form)
    context, belief = context_of(problem, SEED)
    broken = scorer_of(context, belief)[0]
    assessed = broken.assessed(broken.candidate(free.positions_m[1:], plan.rung, plan.termination))
    assert assessed.verdict is Verdict.VIOLATED
    # The bound is used, not only kept: little of what is asked is left over.
    if form not in ("each_step", "outage"):
        assert -result.missing < 0.02 * result.required
    assert plan.termination in RETURNED and plan.iterations > 0
    assert plan.objective >= plan.lattice_objective


@pytest.mark.parametrize("form", RULES)
def test_no_driven_way_of_many_is_worth_more(form):
    """Random ways that keep the rule are worth no more than the plan."""
    problem = ruled_problem(form)
    context, belief = context_of(problem, SEED)
    scorer, ground = scorer_of(context, belief)
    plan = HorizonPlanner(problem, ground).plan(context, scorer)
    generator = np.random.default_rng(0)
    best = -np.inf
    for _ in range(300):
        heading = generator.uniform(0, 2 * np.pi) + np.cumsum(generator.normal(0, 0.4, 5))
        steps = generator.uniform(0, 2, (5, 1)) * np.stack([np.cos(heading), np.sin(heading)], 1)
        path = context.position_m + np.cumsum(steps, axis=0)
        worth = scorer.objective(path)
        if worth > best:
            found = scorer.assessed(scorer.candidate(path, plan.rung, plan.termination))
            best = worth if found.verdict is Verdict.VERIFIED else best
    assert plan.objective >= best


@pytest.mark.parametrize("form", ["average", "joint", "data"])
def test_priced_slack_is_used_up_to_its_bound(form):
    """Cheap slack is worth its price: the objective has it subtracted, the bound holds."""
    hard = solve(ruled_problem(form), seed=SEED).plans[0]
    soft = solve(ruled_problem(form, slack_max_db=1.0, slack_price=0.01), seed=SEED).plans[0]
    dear = solve(ruled_problem(form, slack_max_db=1.0, slack_price=1e3), seed=SEED).plans[0]
    assert soft.verdict is dear.verdict is Verdict.VERIFIED
    assert 0.0 < soft.certificate.rule.slack_db <= 1.0
    assert soft.objective > hard.objective
    assert "slack" in soft.message
    assert dear.certificate.rule.slack_db < 1e-3


def test_slack_of_single_steps_has_its_price():
    """The objective is that of the terms less price times all missing dB."""
    asked = {"p_min": 0.97, "slack_max_db": 2.0, "slack_price": 0.5}
    problem = ruled_problem("each_step", **asked)
    context, belief = context_of(problem, SEED)
    scorer, ground = scorer_of(context, belief)
    plan = HorizonPlanner(problem, ground).plan(context, scorer)
    missing = sum(plan.certificate.relaxation_db)
    assert plan.verdict is Verdict.VERIFIED
    assert 0.0 < missing
    assert max(plan.certificate.relaxation_db) <= 2.0 + 1e-6
    terms = sum(ObjectiveValue(context).by_term(plan.positions_m[1:]))
    assert plan.objective == pytest.approx(terms - 0.5 * missing, abs=1e-6)


def test_rule_that_nothing_keeps_is_said():
    """No verified plan; the reason has the rule's words and its key."""
    plan = solve(ruled_problem("joint", p_min=0.999999), seed=SEED).plans[0]
    assert plan.verdict is Verdict.VIOLATED
    assert "all steps of the plan" in plan.message
    assert "constraints.p_min" in plan.message


def test_rules_for_terms_that_couple_places():
    """Learning under the joint rule and under that of data."""
    for form in ("joint", "data"):
        problem = ruled_problem(form)
        learning = replace(terms_problem(LEARNING, horizon=4), constraints=problem.constraints)
        plan = solve(learning, seed=SEED).plans[0]
        assert plan.verdict is Verdict.VERIFIED
        assert plan.certificate.rule.connectivity == form


def test_run_minds_what_has_happened():
    """A run that has delivered everything early plans freely; the history is the truth's."""
    rule = ConnectivityRule("data", data_mbit=1.0, deadline_s=8.0, rate_mbit_s=1.0)
    problem = ruled_problem("data")
    problem = replace(problem, constraints=replace(problem.constraints, rule=rule))
    run = simulate(problem, seed=SEED)
    first = int(np.argmax(run.runs[0].log.connected[1:])) + 1
    asked = [plan.certificate.rule.required for plan in run.plans[0]]
    assert all(value > 0.0 for value in asked[:first])
    assert all(value == 0.0 for value in asked[first:])
    assert run.metrics["data_mbit"] == run.runs[0].log.connected[1:].sum()


def test_planned_probability_is_kept_by_sampled_channels():
    """Where our plan's bound is active, 90 % of the channels given the measurements connect."""
    problem = terms_problem(TRACKING, p_min=0.9)
    solution = solve(problem, seed=SEED)
    plan = solution.plans[0]
    drawn = sample_power(
        solution.belief.posterior, plan.positions_m[1:], 20_000, np.random.default_rng(11)
    )
    connected = (drawn >= problem.stations[0].threshold_dbm).sum(axis=0)
    worst = int(np.argmin(connected))
    assert plan.connectivity[1 + worst] < 0.902
    assert binomtest(int(connected[worst]), 20_000).proportion_ci(0.99).high >= 0.9
