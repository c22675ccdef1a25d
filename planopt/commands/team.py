"""``planopt solve`` and ``planopt simulate`` for problems whose objective is a sum of terms."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from planopt.commands.output import (
    apart_in_words,
    drawing,
    explained,
    planned_in_words,
    progress,
    results_folder,
    show,
    shown_number,
)
from planopt.commands.planning import Asked

if TYPE_CHECKING:
    from planopt.planning.solution import Solution
    from planopt.planning.team.team_run import TeamRun

NOT_VERIFIED, NOT_DONE = 3, 4


def solve_asked(asked: Asked) -> int:
    """Plan for each robot. Exit code 0 verified, 3 not verified."""
    from dataclasses import replace

    from planopt.planning.explain.explain import explain
    from planopt.planning.files.saved import PLAN_OR_RUN
    from planopt.planning.files.team_saved import save_team_solution
    from planopt.planning.files.team_solution_json import team_solution_json
    from planopt.planning.plan import Verdict
    from planopt.planning.solve import solve

    figures = asked.problem.report.figures
    with results_folder(asked.out) as folder:
        with progress("planning"):
            solution = solve(asked.problem, seed=asked.seed)
        if solution.verdict is not Verdict.VERIFIED:
            with progress("explaining"):
                solution = replace(solution, explanation=explain(solution))
        if folder is not None:
            save_team_solution(solution, folder, pictures_follow=figures)
        show(asked.json, team_solution_json(solution), _plans_in_words(solution))
        with drawing(folder, PLAN_OR_RUN, wanted=figures) as new:
            if new is not None:
                from planopt.commands.pictures import picture_team_plan

                target_m = solution.aims[0].target_m
                picture_team_plan(solution.problem, solution.plans, solution.belief, target_m, new)
    return 0 if solution.verdict is Verdict.VERIFIED else NOT_VERIFIED


def simulate_asked(asked: Asked) -> int:
    """Drive all robots. Exit code 0 verified throughout, 3 not, 4 stalled or never connected."""
    from planopt.planning.files.saved import PLAN_OR_RUN
    from planopt.planning.files.team_run_json import team_run_json
    from planopt.planning.files.team_saved import save_team_run
    from planopt.planning.loop.run import Outcome
    from planopt.planning.team.team_loop import simulate_team

    with results_folder(asked.out) as folder:
        with progress("driving, steps:", asked.problem.planner.max_steps) as advance:
            run = simulate_team(asked.problem, seed=asked.seed, on_step=lambda _: advance())
        if folder is not None:
            save_team_run(run, folder, pictures_follow=asked.has_pictures)
        show(asked.json, team_run_json(run), _run_in_words(run))
        with drawing(folder, PLAN_OR_RUN, wanted=asked.has_pictures) as new:
            if new is not None:
                from planopt.commands.pictures import animate, picture_team_run

                if asked.problem.report.figures:
                    picture_team_run(run, new)
                if asked.animation:
                    animate(run, new)
    if run.runs[0].outcome is not Outcome.COMPLETED:
        return NOT_DONE
    return 0 if run.verified_rate == 1.0 else NOT_VERIFIED


def _plans_in_words(solution: Solution) -> str:
    problem = solution.problem
    value, count = sum(plan.objective for plan in solution.plans), len(solution.plans)
    lines = [
        f"{problem.name}: {solution.verdict.value}, horizon {problem.planner.horizon}, "
        f"planner {problem.planner.name}, seed {solution.seed}",
        f"  value {shown_number(value)}" + (f" of {count} plans" if count > 1 else ""),
    ]
    for plan in solution.plans:
        certificate = plan.certificate
        lines.append(
            f"  {plan.robot}: {plan.verdict.value} ({plan.rung.value}, {plan.termination.value}), "
            f"value {shown_number(plan.objective)}, of the lattice path "
            f"{shown_number(plan.lattice_objective)}; "
            f"{planned_in_words(certificate.min_clearance_m, certificate.min_connectivity)} "
            f"({certificate.posterior}); "
            f"{shown_number(plan.wall_s, ' s', 2)}"
        )
        lines += (
            "  " + words
            for words in apart_in_words(
                certificate.min_separation_m, certificate.min_moving_clearance_m
            )
        )
        if certificate.rule is not None:
            lines.append(f"    {certificate.rule.words}")
        if plan.message:
            lines.append(f"    {plan.message}")
        lines += [f"  {line}" for line in explained(_of(plan.robot, solution))]
    return "\n".join(lines)


def _of(robot: str, solution: Solution) -> list[object]:
    """What would help one robot."""
    return [one for one in solution.explanation if one.robot == robot]


def _run_in_words(run: TeamRun) -> str:
    from planopt.planning.loop.metrics import run_reliability
    from planopt.report.tables import reliability_lines

    planner = run.problem.planner
    rungs: Counter[str] = Counter()
    for one in run.runs:
        rungs.update(one.rungs)
    first = run.runs[0]
    robots = "1 robot" if len(run.runs) == 1 else f"{len(run.runs)} robots"
    shown = ", ".join(f"{name} {shown_number(value)}" for name, value in run.metrics.items())
    steps = sum(len(one.log.t_s) - 1 for one in run.runs)
    measured = sum(one.metrics.measured_steps for one in run.runs)
    return "\n".join(
        [
            f"{run.problem.name}: {first.outcome.value} ({first.reason}), horizon "
            f"{planner.horizon}, planner {planner.name}, seed {run.seed}",
            f"  {robots}, {run.verified_rate:.1%} of the steps verified "
            f"({', '.join(f'{name} {count}' for name, count in rungs.items())})",
            f"  measured at {measured} of {steps} steps",
            f"  {shown}",
            *(f"  {line}" for line in reliability_lines(run_reliability(run.runs), "steps")),
        ]
    )
