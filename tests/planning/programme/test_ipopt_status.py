"""Every status of IPOPT has a meaning, and none that is not a solution is taken for one."""

import re
from pathlib import Path

import casadi as ca
import pytest

from planopt.extend import Termination
from planopt.planning.programme.solver import TERMINATIONS, termination_of

SOLVED = (Termination.CONVERGED, Termination.ACCEPTABLE)


def test_the_table_covers_the_installed_ipopt():
    """Every status of its header; one means converged, and two acceptable."""
    kept = {status: found for status, found in TERMINATIONS.items() if found in SOLVED}
    assert kept.pop("Solve_Succeeded") is Termination.CONVERGED
    assert set(kept) == {"Solved_To_Acceptable_Level", "Feasible_Point_Found"}
    headers = list(Path(ca.GlobalOptions.getCasadiIncludePath()).rglob("IpReturnCodes_inc.h"))
    if not headers:
        pytest.skip("this CasADi ships no IPOPT headers")
    body = headers[0].read_text().split("enum ApplicationReturnStatus")[1].split("}")[0]
    statuses = re.findall(r"^\s*([A-Z]\w+)\s*=\s*-?\d+", body, re.MULTILINE)
    assert len(statuses) >= 20
    assert {s.lower() for s in statuses} <= {s.lower() for s in TERMINATIONS}


@pytest.mark.parametrize("status", ["", "Unknown", "solve_succeeded", "NLP_Solver_Broke"])
def test_an_unknown_status_is_a_numerical_failure(status):
    """Whatever a later IPOPT may say, it is not a success by accident."""
    assert termination_of(status) is Termination.NUMERICAL_FAILURE


def probe(f, g=None, *, lbx=-ca.inf, x0=1.0, **options):
    """Raw status of a one-variable problem, by CasADi itself."""
    x = ca.SX.sym("x")
    problem = {"x": x, "f": f(x)} | ({} if g is None else {"g": g(x)})
    quiet = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False}
    solver = ca.nlpsol("s", "ipopt", problem, quiet | options | {"show_eval_warnings": False})
    solver(x0=x0, lbx=lbx, **({} if g is None else {"lbg": 0.0, "ubg": 0.0}))
    return solver.stats()["return_status"]


def test_what_ipopt_really_returns():
    """Spelling as the installed solver spells it: solved, infeasible, capped, unbounded, NaN."""
    solved = probe(lambda x: (x - 3.0) ** 2)
    infeasible = probe(lambda x: x, lambda x: x**2 + 1.0)
    capped = probe(lambda x: ca.cosh(x - 3.0), x0=40.0, **{"ipopt.max_iter": 1})
    unbounded = probe(lambda x: -x)
    nan = probe(lambda x: ca.log(x), x0=-1.0)
    assert [termination_of(s) for s in (solved, capped, nan)] == [
        Termination.CONVERGED,
        Termination.ITERATION_LIMIT,
        Termination.NUMERICAL_FAILURE,
    ]
    assert termination_of(infeasible) in {Termination.INFEASIBLE, Termination.NUMERICAL_FAILURE}
    assert {solved, infeasible, capped, unbounded, nan} <= set(TERMINATIONS)
