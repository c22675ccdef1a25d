"""The figure of a whole result: the plans of a solution, or a run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planopt.planning.run import Run
from planopt.planning.solution import Solution
from planopt.report.plan_figure import draw_plan
from planopt.report.run_figure import draw_run
from planopt.report.team_figure import draw_team_plan, draw_team_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_solution(solution: Solution) -> Figure:
    """Draw the plans on the map, their predictions and their certificates."""
    if solution.problem.task == "reach":
        return draw_plan(solution)
    target_m = solution.aims[0].target_m
    return draw_team_plan(solution.problem, solution.plans, solution.belief, target_m)


def draw_driven(run: Run) -> Figure:
    """Draw where the robots drove: on the ground truth to a goal, else on what they believed."""
    return draw_run(run) if run.problem.task == "reach" else draw_team_run(run)
