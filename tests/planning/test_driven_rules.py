"""Robots that cannot turn or stop at will, under every rule of connectivity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motion_scene import DOUBLE, WHEELS, driven_problem, with_dynamics
from rules_scene import RULES, ruled_problem
from terms_scene import TRACKING

from planopt import check
from planopt.planning.explain.explain import explain
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.plan import Verdict
from planopt.planning.solve import solve
from planopt.problems import SingleIntegrator

SEED = 3


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("form", RULES)
def test_plan_is_judged_under_the_rule(dynamics, form: str) -> None:
    """With a little slack each is kept; a plan of the solver is a KKT point."""
    problem = with_dynamics(ruled_problem(form, slack_max_db=6.0), dynamics)
    plan = solve(problem, seed=SEED).plans[0]
    assert plan.verdict is Verdict.VERIFIED
    assert plan.certificate.rule is not None
    assert plan.certificate.rule.connectivity == form
    if plan.certificate.kkt_residual is not None:
        assert plan.certificate.kkt_residual < 1e-2


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("horizon", [1, 3])
def test_missed_steps_are_excused_by_where_it_can_be(dynamics, horizon: int, tmp_path) -> None:
    """Where nothing within reach keeps the bound; a robot that turns at will has more in reach."""
    problem = driven_problem(dynamics, TRACKING, p_min=0.9, horizon=horizon, max_steps=4)
    robot = replace(problem.robots[0], start_m=(37.0, 37.0))
    problem = replace(problem, robots=(robot,))
    plan = solve(problem, seed=SEED).plans[0]
    certificate = plan.certificate
    assert certificate.relaxed_steps
    free = replace(problem, robots=(replace(robot, dynamics=SingleIntegrator(), start_rest=()),))
    wide = solve(free, seed=SEED).plans[0].certificate
    assert wide.relaxed_steps == certificate.relaxed_steps
    assert np.all(np.array(certificate.best_margin_db) <= np.array(wide.best_margin_db) + 0.05)
    assert certificate.best_margin_db[0] < wide.best_margin_db[0]
    run = simulate(problem, seed=SEED)
    run.save(tmp_path)
    assert not [text for text in check(tmp_path).reasons if "is met at none of" not in text]


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("uncertain", ["path_loss", "all"])
def test_what_would_help_is_measured_where_it_can_be(dynamics, uncertain: str) -> None:
    """The shortfall is what the verifier misses, and both proposals are verified."""
    problem = driven_problem(dynamics, TRACKING, p_min=0.9, horizon=1)
    robot = replace(problem.robots[0], start_m=(37.0, 37.0))
    rule = replace(problem.constraints.rule, parameter_uncertainty=uncertain)
    constraints = replace(problem.constraints, rule=rule)
    solution = solve(replace(problem, robots=(robot,), constraints=constraints), seed=SEED)
    certificate = solution.plans[0].certificate
    found = {one.constraint: one for one in explain(solution)}
    for key in ("constraints.p_min", "stations[0].threshold_dbm"):
        assert found[key].shortfall == pytest.approx(-certificate.best_margin_db[0], abs=1e-9)
        assert found[key].verified
