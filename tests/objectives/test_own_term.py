"""A user-defined term as a class, against the same expression written by casadi_term."""

import pickle
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import casadi as ca
import numpy as np
import pytest
from refusals import refused
from terms_scene import LEARNING, context_of, terms_problem

from planopt import compare, load
from planopt.extend import OwnTerm, casadi_term
from planopt.objectives import TermsObjective
from planopt.planning.search.local_ranking import LocalRanking
from planopt.planning.solve import solve
from planopt.planning.values.local_value import local_value
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.problems import problem_to_dict
from planopt.problems.load import with_overrides


@pytest.fixture
def near_term(own_parts):
    @dataclass(frozen=True)
    class NearTerm(OwnTerm):
        """Stay near a place, connected."""

        x_m: float
        y_m: float = 20.0

        kind: ClassVar[str] = "near"

        def expression(self, path):
            away = (path.positions_m[:, 0] - self.x_m) ** 2
            away += (path.positions_m[:, 1] - self.y_m) ** 2
            return ca.sum1(path.connectivity * ca.exp(-away / 200.0))

    return NearTerm


def test_it_is_the_expression_of_its_fields(near_term):
    """Value, values, derivatives and the plan itself, to rounding."""
    base = terms_problem(LEARNING)
    own = near_term(16.0, weight=2.0)
    written = casadi_term(own.expression, 5, weight=2.0)
    problems = [replace(base, objective=TermsObjective((each,))) for each in (own, written)]
    mine, same = (context_of(each)[0] for each in problems)
    path = mine.position_m + np.cumsum(np.full((5, 2), 0.8), axis=0)
    assert ObjectiveValue(mine)(path) == pytest.approx(ObjectiveValue(same)(path), rel=1e-12)
    ranked = [LocalRanking(each, path[None])(path[None])[0] for each in (mine, same)]
    assert ranked[0] == pytest.approx(ranked[1], rel=1e-12)
    found, wanted = (local_value(each, path)(path).value for each in (mine, same))
    np.testing.assert_allclose(found.gradient, wanted.gradient, rtol=1e-12)
    np.testing.assert_allclose(found.hessian, wanted.hessian, rtol=1e-12)
    plans = [solve(each, seed=0).plans[0] for each in problems]
    assert plans[0].verdict.value == "verified"
    np.testing.assert_allclose(plans[0].positions_m, plans[1].positions_m, atol=1e-9)


def test_an_expression_follows_the_horizon() -> None:
    """An override of the horizon writes the text again; a pickled term keeps its text alone."""
    term = casadi_term(lambda path: -(path.positions_m[-1, 0] ** 2), 5, weight=2.0)
    problem = with_overrides(
        replace(load("outdoor_map"), objective=TermsObjective((term,))), horizon=3
    )
    (own,) = problem.terms
    assert own == casadi_term(lambda path: -(path.positions_m[-1, 0] ** 2), 3, weight=2.0)
    assert problem_to_dict(problem)["objective"]["terms"][0].keys() == {
        *("kind", "weight", "steps", "program")
    }
    planner = replace(problem.planner, max_steps=1)
    compared = compare(replace(problem, planner=planner), horizons=[1, 3], seeds=1)
    assert [(run.horizon, run.exit_code) for run in compared.runs] == [(1, 0), (3, 0)]
    kept = pickle.loads(pickle.dumps(own))
    assert kept == own
    assert kept.at_horizon(4) is kept


def test_an_expression_that_is_none_is_refused(near_term):
    @dataclass(frozen=True)
    class BadTerm(near_term):
        """No scalar."""

        kind: ClassVar[str] = "bad"

        def expression(self, path):
            return path.positions_m

    problem = replace(terms_problem(LEARNING), objective=TermsObjective((BadTerm(2.0),)))
    with refused():
        solve(problem, seed=0)


SCRIPT = """
from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca
import planopt
from planopt.extend import OwnTerm


@dataclass(frozen=True)
class EastTerm(OwnTerm):
    kind: ClassVar[str] = "east"

    def expression(self, path):
        return ca.sum1(path.positions_m[:, 0])


if __name__ == "__main__":
    problem = planopt.load("outdoor_map")
    settings = replace(problem.planner, max_steps=2)
    problem = replace(problem, objective=EastTerm(), planner=settings)
    found = planopt.compare(problem, [2], seeds=range(2), workers=2)
    print(len(found.runs))
"""


def test_workers_know_terms_of_a_script(tmp_path: Path):
    """A class that only the script has reaches the processes of its comparison."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode, done.stdout) == (0, "2\n"), done.stderr
