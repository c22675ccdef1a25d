"""One plan from a problem: overrides, exit codes, and clear answers where there is no good one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planopt import load
from planopt.errors import InputError
from planopt.planning.loop.results import Solution
from planopt.planning.plan import Verdict
from planopt.planning.solve import solve


@pytest.fixture(scope="module")
def solution() -> Solution:
    """The open field as it is."""
    return solve(load("open_field"))


def test_library_problem(solution):
    """Verified, no worse than the lattice, exit code 0."""
    plan = solution.plan
    assert plan.verdict is Verdict.VERIFIED
    assert solution.exit_code == 0
    assert plan.objective <= plan.lattice_objective
    assert plan.certificate.min_clearance_m >= 1.5 - 1e-6
    assert plan.certificate.min_connectivity >= 0.8 - 1e-6
    assert plan.certificate.kkt_residual < 1e-3
    assert (plan.t_s == 2.0 * np.arange(11)).all()


def test_overrides():
    """They are in the problem that was solved."""
    found = solve(load("open_field"), horizon=3, planner="lattice", cost_to_go="geodesic")
    assert found.problem.planner.horizon == 3
    assert found.problem.planner.name == "lattice"
    assert found.problem.objective.cost_to_go == "geodesic"
    assert found.plan.positions_m.shape == (4, 2)
    assert found.plan.objective == found.plan.lattice_objective


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ({"horizon": 0}, "planner.horizon"),
        ({"horizon": 10_000}, "planner.horizon"),
        ({"planner": "oracle"}, "planner.name"),
        ({"cost_to_go": "crow"}, "objective.cost_to_go"),
    ],
)
def test_override_that_is_not_allowed(override, key):
    """One clear error with the key of the problem file."""
    with pytest.raises(InputError) as caught:
        solve(load("open_field"), **override)
    assert caught.value.key == key


@pytest.mark.parametrize("horizon", [1, 10])
def test_threshold_that_cannot_be_met(horizon):
    """No place on earth: violated, with numbers, and exit code 3."""
    problem = load("open_field")
    radio = replace(problem.stations[0], threshold_dbm=40.0)
    found = solve(replace(problem, stations=(radio,)), horizon=horizon)
    assert found.plan.verdict is Verdict.VIOLATED
    assert found.exit_code == 3
    assert "constraints.p_min 0.8" in found.plan.message
    assert "dB" in found.plan.message
    assert len(found.plan.certificate.relaxed_steps) == horizon


@pytest.mark.parametrize(
    ("verdict", "code"),
    [
        (Verdict.VERIFIED, 0),
        (Verdict.FEASIBLE_UNVERIFIED, 3),
        (Verdict.VIOLATED, 3),
        (Verdict.NONE, 4),
    ],
)
def test_exit_codes(solution, verdict, code):
    """Design section 3."""
    assert replace(solution, plans=(replace(solution.plan, verdict=verdict),)).exit_code == code
