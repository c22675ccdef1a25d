"""Verdicts and certificates in words."""

from dataclasses import replace

import pytest

from planopt.planning.certificate import RuleResult
from planopt.planning.plan import Verdict
from planopt.problems.constraints import ConnectivityRule
from planopt.report.plan_words import MEANING, plan_words


def test_all_numbers(plan, problem):
    """Every number of the certificate, with what was asked."""
    assert plan_words(plan, problem.constraints) == [
        "verdict: verified (constraints hold; "
        "contact is left only where unavoidable or worth its price)",
        "least clearance 1.625 m along the swept path, 1.5 m required",
        "least P(connected) 0.812, 0.8 required (posterior: exact)",
        "motion model satisfied to 2.5e-09 m; KKT residual of the refinement 3.5e-07",
        "cost 101.2 s (lattice start 103.5 s); converged after 17 iterations, 42 ms; "
        "fallback: plan",
        "the bound is not met at 1 of 4 steps; missed by at most 0.75 dB",
    ]


@pytest.mark.parametrize("verdict", list(Verdict))
def test_every_verdict_has_words(plan, problem, verdict):
    """No verdict is without its meaning."""
    assert MEANING[verdict] in plan_words(replace(plan, verdict=verdict), problem.constraints)[0]


def test_missing_parts(plan, problem):
    """No obstacles, no polish, no relaxation; reasons and message come last."""
    certificate = replace(
        plan.certificate,
        min_clearance_m=float("inf"),
        kkt_residual=None,
        relaxed_steps=(),
        relaxation_db=(),
        reasons=("first", "second"),
    )
    words = plan_words(replace(plan, certificate=certificate, message="third"), problem.constraints)
    assert words[1] == "no obstacles to keep clear of"
    assert words[3].endswith("not refined")
    assert words[5:] == ["first", "second", "third"]


def test_rule_of_connectivity_has_its_line(plan, problem):
    """What was asked and achieved, by which method, with which slack."""
    rule = RuleResult("each_step", 2.0, 3.0, "steps", "p_min at each step asked for", 0.5)
    ruled = replace(plan, certificate=replace(plan.certificate, rule=rule))
    words = "\n".join(plan_words(ruled, problem.constraints))
    assert "connectivity (each step): 2 steps, 3 steps asked" in words
    assert "slack 0.50 dB" in words


@pytest.mark.parametrize(("form", "asked"), [("joint", False), ("data", False), ("outage", True)])
def test_a_bound_is_asked_of_steps_only_where_it_is(plan, problem, form, asked):
    """What a rule asks of all steps together says nothing of the least of them."""
    constraints = replace(problem.constraints, rule=ConnectivityRule(form))
    assert (", 0.8 required" in "\n".join(plan_words(plan, constraints))) == asked
