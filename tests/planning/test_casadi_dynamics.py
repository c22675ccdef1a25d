"""Plans with dynamics from a CasADi function, against the same model written out."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from motion_scene import DOUBLE, WHEELS, planned, with_dynamics
from terms_scene import TRACKING, terms_problem

from planopt.errors import InputError
from planopt.planning.plan import Verdict
from planopt.problems import problem_to_dict
from planopt.robots.casadi_map import CasadiMap

FREE = (-np.inf, np.inf)


def wheels() -> CasadiMap:
    """The unicycle of the scene by its derivative."""
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 2)
    slope = ca.vertcat(u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1])
    return CasadiMap(
        ca.Function("slope", [x, u], [slope]),
        WHEELS.state_names,
        WHEELS.input_names,
        2.0,
        (FREE, FREE, FREE),
        ((0.0, 2.0), (-0.9, 0.9)),
        (0.0, 0.0),
        continuous=True,
        substeps=8,
    )


def heavy() -> CasadiMap:
    """A double integrator in a square of velocities and accelerations, as a discrete map."""
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    after = ca.vertcat(x[:2] + x[2:] + 0.5 * u, x[2:] + u)
    most, hard = 2.0 / np.sqrt(2.0), 0.8 / np.sqrt(2.0)
    return CasadiMap(
        ca.Function("after", [x, u], [after]),
        DOUBLE.state_names,
        DOUBLE.input_names,
        2.0,
        (FREE, FREE, (-most, most), (-most, most)),
        ((-hard, hard), (-hard, hard)),
        (0.0, 0.0),
    )


@pytest.mark.parametrize(("own", "exact"), [(wheels(), WHEELS), (heavy(), DOUBLE)])
def test_plan_is_verified_and_no_better_than_the_exact_models(own, exact) -> None:
    """The map knows less of its way, and must end at rest, so that it cannot do better."""
    problem = terms_problem(TRACKING, horizon=5)
    plan, _, _, _ = planned(with_dynamics(problem, own))
    assert plan.verdict is Verdict.VERIFIED
    end = plan.drive.states[-1]
    assert np.array(own.step(tuple(end), (0.0, 0.0), 1.0)) == pytest.approx(end, abs=1e-5)
    reference, _, _, _ = planned(with_dynamics(problem, exact))
    assert plan.objective <= reference.objective * (1.0 + 1e-3)
    assert plan.objective >= 0.5 * reference.objective


def test_a_function_is_not_for_files() -> None:
    """Saving says so."""
    with pytest.raises(InputError, match="cannot be saved"):
        problem_to_dict(with_dynamics(terms_problem(TRACKING), wheels()))
