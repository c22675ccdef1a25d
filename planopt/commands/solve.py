"""``planopt solve``: one plan from the start."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planopt.commands.output import (
    NO_PLAN,
    apart_in_words,
    drawing,
    explained,
    planned_in_words,
    progress,
    results_folder,
    show,
    shown_number,
)
from planopt.commands.planning import Asked, planning_command
from planopt.commands.team import solve_asked

if TYPE_CHECKING:
    from planopt.planning.solution import Solution


@planning_command
def solve(asked: Asked) -> int:
    """Plan from the start. Exit code 0 verified, 3 not verified, 4 no plan."""
    from dataclasses import replace

    from planopt.errors import NoPlanError
    from planopt.planning.explain.explain import explain, explain_no_plan
    from planopt.planning.files.saved import PLAN_FILE, PLAN_OR_RUN, save_no_plan, save_solution
    from planopt.planning.files.solution_json import no_plan_json, solution_json
    from planopt.planning.solution import exit_code
    from planopt.planning.solve import solve as find_plan

    if asked.problem.task != "reach":
        return solve_asked(asked)
    problem, seed = asked.problem, asked.seed
    with results_folder(asked.out) as folder:
        try:
            with progress("planning"):
                solution = find_plan(problem, seed=seed)
        except NoPlanError as error:
            with progress("explaining"):
                helpful = explain_no_plan(problem, seed)
            data = no_plan_json(problem, seed, str(error), helpful)
            if folder is not None:
                save_no_plan(data, problem, folder, PLAN_FILE)
            lines = [f"{problem.name}: no plan: {error}", *explained(helpful)]
            show(asked.json, data, "\n".join(lines))
            return NO_PLAN
        if exit_code(solution) != 0:
            with progress("explaining"):
                solution = replace(solution, explanation=explain(solution))
        if folder is not None:
            save_solution(solution, folder, pictures_follow=problem.report.figures)
        show(asked.json, solution_json(solution), _in_words(solution))
        with drawing(folder, PLAN_OR_RUN, wanted=problem.report.figures) as new:
            if new is not None:
                from planopt.commands.pictures import picture_solution

                picture_solution(solution, new)
    return exit_code(solution)


def _in_words(solution: Solution) -> str:
    from planopt.planning.holes import goal_in_words, holes_in_words

    plan, certificate = solution.plan, solution.plan.certificate
    lines = [
        f"{solution.problem.name}: {plan.verdict.value} ({plan.rung.value}, "
        f"{plan.termination.value}), horizon {len(plan.t_s) - 1}, seed {solution.seed}",
        f"  cost {shown_number(plan.objective, ' s')}, of the lattice path "
        f"{shown_number(plan.lattice_objective, ' s')}; {plan.iterations} iterations, "
        f"{shown_number(plan.wall_s, ' s', 2)}",
        f"  {planned_in_words(certificate.min_clearance_m, certificate.min_connectivity)} "
        f"({certificate.posterior})",
        *apart_in_words(certificate.min_separation_m, certificate.min_moving_clearance_m),
    ]
    if certificate.rule is not None:
        lines.append(f"  {certificate.rule.words}")
    if plan.message:
        lines.append(f"  {plan.message}")
    words = goal_in_words(solution.problem, plan.holes)
    words += holes_in_words(solution.problem, plan.holes, "the way to the goal crosses")
    lines += [f"  {line}" for line in words]
    return "\n".join([*lines, *explained(solution.explanation)])
