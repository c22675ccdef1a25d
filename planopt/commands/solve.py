"""``planopt solve``: one plan from the start."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planopt.commands.options import (
    CostToGoOption,
    HorizonOption,
    JsonOption,
    OutOption,
    PlannerOption,
    ProblemArgument,
    SeedOption,
)
from planopt.commands.output import NO_PLAN, progress, results_folder, show, shown_number

if TYPE_CHECKING:
    from planopt.planning.solution import Solution


def solve(
    problem: ProblemArgument,
    horizon: HorizonOption = None,
    planner: PlannerOption = None,
    cost_to_go: CostToGoOption = None,
    seed: SeedOption = 0,
    out: OutOption = None,
    json: JsonOption = False,
) -> int:
    """Plan from the start. Exit code 0 verified, 3 not verified, 4 no plan."""
    from planopt.errors import NoPlanError
    from planopt.planning.saved import PLAN_FILE, save_record, save_solution, withdraw
    from planopt.planning.solution import exit_code
    from planopt.planning.solution_json import no_plan_json, solution_json
    from planopt.planning.solve import solve as find_plan
    from planopt.problems.load import load
    from planopt.problems.overrides import with_overrides

    asked = with_overrides(load(problem), horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    with results_folder(out) as folder:
        try:
            with progress("planning"):
                solution = find_plan(asked, seed=seed)
        except NoPlanError as error:
            data = no_plan_json(asked, seed, str(error))
            if folder is not None:
                withdraw(folder)
                save_record(data, asked, folder / PLAN_FILE)
            show(json, data, f"{asked.name}: no plan: {error}")
            return NO_PLAN
        if folder is not None:
            withdraw(folder)
            if asked.report.figures:
                from planopt.commands.pictures import picture_solution

                with progress("drawing"):
                    picture_solution(solution, folder)
            save_solution(solution, folder)
    show(json, solution_json(solution), _in_words(solution))
    return exit_code(solution)


def _in_words(solution: Solution) -> str:
    plan, certificate = solution.plan, solution.plan.certificate
    lines = [
        f"{solution.problem.name}: {plan.verdict.value} ({plan.rung.value}, "
        f"{plan.termination.value}), horizon {len(plan.t_s) - 1}, seed {solution.seed}",
        f"  cost {shown_number(plan.objective, ' s')}, of the lattice path "
        f"{shown_number(plan.lattice_objective, ' s')}; {plan.iterations} iterations, "
        f"{shown_number(plan.wall_s, ' s', 2)}",
        f"  clearance {shown_number(certificate.min_clearance_m, ' m')}, least probability of "
        f"connection {shown_number(certificate.min_connectivity)} ({certificate.posterior})",
    ]
    return "\n".join([*lines, f"  {plan.message}"] if plan.message else lines)
