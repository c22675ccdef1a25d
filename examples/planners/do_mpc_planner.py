"""do-mpc as a planner from outside, by name, in the regression suite.

``python examples/planners/do_mpc_planner.py bench run --planners auto,do_mpc --out DIR`` registers
the planner ``do_mpc`` and passes the arguments to planopt. It needs the extra ``bench``, and plans
for problems of one station whose first term is tracking.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from time import perf_counter
from typing import Any

from do_mpc_step import DoMpcStep

from planopt import InputError, Plan, Problem
from planopt.cli import main
from planopt.extend import PlannerKind, Rung, register_planner
from planopt.objectives import TrackingTerm
from planopt.planning.candidates import Scorer
from planopt.planning.programme.solver import termination_of
from planopt.planning.scene import Ground
from planopt.planning.values.context import StepContext


class DoMpcPlanner:
    """Plans for one robot with do-mpc: a straight transcription, started from standing still.

    Parameters
    ----------
    problem
        With one robot and one station, and tracking as its first term.
    """

    def __init__(self, problem: Problem, _ground: Ground, _generator: Any) -> None:
        if not isinstance(problem.terms[0], TrackingTerm) or len(problem.stations) > 1:
            raise InputError("is do_mpc, which tracks with one station", key="planner.name")

    def plan(self, situation: StepContext, scorer: Scorer, warm: Plan | None = None) -> Plan:
        """Build the controller, solve once, and let planopt's verifier judge the path."""
        begun = perf_counter()
        built = DoMpcStep(situation, "MX")
        solve_s, _, path_m = built.step()
        candidate = scorer.candidate(path_m, Rung.PLAN, termination_of(built.status))
        found = replace(scorer.assessed(candidate), solve_s=solve_s, iterations=built.iterations)
        return scorer.plan_from(found, wall_s=perf_counter() - begun)


if __name__ == "__main__":
    register_planner(PlannerKind("do_mpc", DoMpcPlanner))
    sys.exit(main())
