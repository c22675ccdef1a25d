"""Plans or a run of several robots as a folder, as for one.

All plans of a solution rest on one belief; after a run each robot has its own.
"""

from __future__ import annotations

from pathlib import Path

from planopt.files.whole import write_text
from planopt.planning.files.belief_file import BELIEF_FILE
from planopt.planning.files.number_table import table_text
from planopt.planning.files.saved import (
    PLAN_FILE,
    RUN_FILE,
    save_record,
    withdraw,
    write_belief_of_plan,
    write_belief_of_run,
)
from planopt.planning.files.steps_file import (
    STEPS_FILE,
    joined_steps,
    steps_of_plan,
    steps_of_run,
    steps_text,
)
from planopt.planning.files.team_run_json import team_plans_json, team_run_json
from planopt.planning.files.team_solution_json import team_solution_json
from planopt.planning.team.team_run import TeamRun
from planopt.planning.team.team_solution import TeamSolution
from planopt.planning.team.team_tables import (
    KNOWLEDGE_FILE,
    TARGET_FILE,
    knowledge_table,
    target_table,
)
from planopt.problems.problem import Problem


def belief_files(problem: Problem) -> tuple[str, ...]:
    """What the beliefs of a run are saved as, by robot."""
    if len(problem.robots) == 1:
        return (BELIEF_FILE,)
    return tuple(f"belief_{robot.name}.npz" for robot in problem.robots)


def save_team_solution(solution: TeamSolution, folder: Path) -> None:
    """Save plans so that they can be judged from their files alone.

    Raises
    ------
    OutputError
        The folder cannot be written; no JSON file is left in it.
    """
    withdraw(folder)
    steps = joined_steps([steps_of_plan(plan) for plan in solution.plans])
    write_text(folder / STEPS_FILE, steps_text(steps))
    write_belief_of_plan(folder / BELIEF_FILE, solution.belief)
    save_record(team_solution_json(solution), solution.problem, folder / PLAN_FILE)


def save_team_run(run: TeamRun, folder: Path) -> None:
    """Save a run so that every released plan can be judged from its files alone.

    Raises
    ------
    OutputError
        The folder cannot be written; no JSON file is left in it.
    """
    withdraw(folder)
    problem = run.problem
    steps = joined_steps([steps_of_run(one.robot, one.log, one.drive) for one in run.runs])
    write_text(folder / STEPS_FILE, steps_text(steps))
    for name, belief, one in zip(belief_files(problem), run.beliefs, run.runs, strict=True):
        write_belief_of_run(folder / name, belief, run.first_measurements, one.log.positions_m)
    if run.target is not None:
        write_text(folder / TARGET_FILE, table_text(target_table(problem, run.target)))
    write_text(folder / KNOWLEDGE_FILE, table_text(knowledge_table(problem, run.channel)))
    data = {**team_run_json(run), "plans": team_plans_json(run.plans, run.aims)}
    save_record(data, problem, folder / RUN_FILE)
