"""``planopt solve``: one plan for each robot from its start."""

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

if TYPE_CHECKING:
    from planopt.planning.plan import Plan
    from planopt.planning.results import Solution
    from planopt.problems.problem import Problem


@planning_command
def solve(asked: Asked) -> int:
    """Plan once, from the start. Exit code 0 verified, 3 not verified, 4 no plan."""
    from dataclasses import replace

    from planopt.errors import NoPlanError
    from planopt.planning.explain.explain import explain, explain_no_plan
    from planopt.planning.files.result_json import no_plan_json, solution_json
    from planopt.planning.files.saved import PLAN_FILE, PLAN_OR_RUN, save_no_plan
    from planopt.planning.holes import BlockedError
    from planopt.planning.solve import solve as find_plans

    problem, seed = asked.problem, asked.seed
    with results_folder(asked.out) as folder:
        try:
            with progress("planning"):
                solution = find_plans(problem, seed=seed)
        except NoPlanError as error:
            # The answer comes at once; what would help is solved for, which takes longer.
            if not asked.json:
                show(asked.json, {}, f"{problem.name}: no plan: {error}")
            with progress("explaining"):
                helpful = explain_no_plan(problem, seed)
            blocked = error.blocked if isinstance(error, BlockedError) else ()
            data = no_plan_json(problem, seed, str(error), helpful, blocked)
            drawn = bool(blocked) and problem.report.figures
            if folder is not None:
                save_no_plan(data, problem, folder, PLAN_FILE)
            words = explained(helpful) or [
                "  no change of a single key or obstacle that was tried helps"
            ]
            show(asked.json, data, "\n".join(words))
            with drawing(folder, PLAN_OR_RUN, wanted=drawn) as new:
                if new is not None and isinstance(error, BlockedError):
                    from planopt.commands.pictures import picture_no_plan

                    picture_no_plan(problem, seed, error, new)
            return NO_PLAN
        crosses = any(plan.holes for plan in solution.plans)
        if solution.exit_code != 0 or crosses:
            with progress("explaining"):
                solution = replace(solution, explanation=explain(solution))
        if folder is not None:
            solution.save(folder)
        show(asked.json, solution_json(solution), _in_words(solution))
        with drawing(folder, PLAN_OR_RUN, wanted=problem.report.figures) as new:
            if new is not None:
                from planopt.commands.pictures import picture_solution

                picture_solution(solution, new)
    return solution.exit_code


def _in_words(solution: Solution) -> str:
    from planopt.planning.explain.explanation import Crossing
    from planopt.problems.problem import problem_of_robot

    problem, plans = solution.problem, solution.plans
    lines = [
        f"{problem.name}: {solution.verdict.value}, horizon {problem.planner.horizon}, "
        f"planner {problem.planner.name}, seed {solution.seed}"
    ]
    if len(plans) > 1:
        total = sum(plan.objective for plan in plans)
        lines.append(f"  {_value(problem, total)} of {len(plans)} plans")
    for number, plan in enumerate(plans):
        lines += _plan_in_words(problem_of_robot(problem, number), plan)
        own = [one for one in solution.explanation if one.robot == plan.robot]
        # The holes themselves stand above.
        told = [one.why if isinstance(one, Crossing) else one for one in own]
        lines += [f"  {line}" for line in explained(told)]
    return "\n".join(lines)


def _value(problem: Problem, objective: float) -> str:
    """An objective value with its unit: a cost in seconds where there is a goal."""
    if problem.task == "reach":
        return f"cost {shown_number(objective, ' s')}"
    return f"value {shown_number(objective)}"


def _plan_in_words(problem: Problem, plan: Plan) -> list[str]:
    from planopt.planning.holes import goal_in_words, holes_in_words

    proof, unit = plan.certificate, " s" if problem.task == "reach" else ""
    lines = [
        f"{plan.robot}: {plan.verdict.value} ({plan.rung.value}, {plan.termination.value}), "
        f"{_value(problem, plan.objective)}, of the lattice path "
        f"{shown_number(plan.lattice_objective, unit)}; {plan.iterations} iterations, "
        f"{shown_number(plan.wall_s, ' s', 2)}",
        f"  {planned_in_words(proof.min_clearance_m, proof.min_connectivity)} ({proof.posterior})",
        *apart_in_words(proof.min_separation_m, proof.min_moving_clearance_m),
    ]
    if proof.rule is not None:
        lines.append(f"  {proof.rule.words}")
    if plan.message:
        lines.append(f"  {plan.message}")
    if problem.task == "reach":
        words = goal_in_words(problem, plan.holes)
        words += holes_in_words(problem, plan.holes, "the way to the goal crosses")
        lines += [f"  {line}" for line in words]
    return [f"  {line}" for line in lines]
