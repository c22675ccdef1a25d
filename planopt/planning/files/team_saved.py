"""Plans or a run of several robots as a folder, as for one.

All plans of a solution rest on one belief; after a run each robot has its own.
"""

from __future__ import annotations

from pathlib import Path

from planopt.files.result_folder import replaced_results
from planopt.files.whole import write_text
from planopt.planning.files.belief_file import BELIEF_FILE
from planopt.planning.files.number_table import table_text
from planopt.planning.files.saved import (
    PLAN_FILE,
    PLAN_OR_RUN,
    RUN_FILE,
    write_belief_of_plan,
    write_belief_of_run,
    write_record,
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
from planopt.planning.solution import Solution
from planopt.planning.team.team_run import TeamRun
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


def save_team_solution(solution: Solution, folder: Path, *, pictures_follow: bool = False) -> None:
    """Save plans so that they can be judged from their files alone.

    Parameters and errors are those of :func:`planopt.planning.files.saved.save_solution`.
    """
    steps = joined_steps([steps_of_plan(plan) for plan in solution.plans])
    with replaced_results(folder, PLAN_OR_RUN, pictures_follow=pictures_follow) as new:
        write_text(new / STEPS_FILE, steps_text(steps))
        write_belief_of_plan(new / BELIEF_FILE, solution.belief)
        write_record(team_solution_json(solution), solution.problem, new / PLAN_FILE)


def save_team_run(run: TeamRun, folder: Path, *, pictures_follow: bool = False) -> None:
    """Save a run so that every released plan can be judged from its files alone.

    Parameters and errors are those of :func:`planopt.planning.files.saved.save_solution`.
    """
    problem = run.problem
    steps = joined_steps([steps_of_run(one.robot, one.log, one.drive) for one in run.runs])
    data = {**team_run_json(run), "plans": team_plans_json(run.plans, run.aims)}
    with replaced_results(folder, PLAN_OR_RUN, pictures_follow=pictures_follow) as new:
        write_text(new / STEPS_FILE, steps_text(steps))
        for name, belief, one in zip(belief_files(problem), run.beliefs, run.runs, strict=True):
            write_belief_of_run(new / name, belief, run.first_measurements, one.log.positions_m)
        if run.target is not None:
            write_text(new / TARGET_FILE, table_text(target_table(problem, run.target)))
        write_text(new / KNOWLEDGE_FILE, table_text(knowledge_table(problem, run.channel)))
        write_record(data, problem, new / RUN_FILE)
