"""Read saved plans or a saved run of a problem whose objective is a sum of terms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.planning.files.belief_file import BELIEF_FILE, SavedBelief, read_belief
from planopt.planning.files.drive_table import drive_columns
from planopt.planning.files.number_table import read_table
from planopt.planning.files.read_saved import (
    damaged,
    record_of,
    require_complete_robot,
    require_even,
    require_rows,
)
from planopt.planning.files.saved import PLAN_FILE
from planopt.planning.files.solution_json import REMEDY
from planopt.planning.files.steps_file import STEPS_FILE, Steps, read_steps
from planopt.planning.files.team_run_json import TeamRunRecord
from planopt.planning.files.team_saved import belief_files
from planopt.planning.files.team_solution_json import TeamPlanRecord
from planopt.planning.team.team_tables import (
    KNOWLEDGE_COLUMNS,
    KNOWLEDGE_FILE,
    TARGET_FILE,
    target_columns,
)
from planopt.problems.problem import Problem
from planopt.problems.save import problem_from_dict


@dataclass(frozen=True, eq=False)
class SavedTeam:
    """Saved plans or a saved run of several robots, read but not judged.

    Attributes
    ----------
    file, data
        Its JSON file, and what that says in full.
    record
        The same, typed, as far as judging needs it.
    problem
        Rebuilt from it.
    steps
        The rows of each robot.
    beliefs
        Of each robot after a run; the one that plans rest on.
    tables
        By file name: the target's, where there is one, and what was known, of a run.
    """

    file: Path
    data: Mapping[str, Any]
    record: TeamPlanRecord | TeamRunRecord
    problem: Problem
    steps: tuple[Steps, ...]
    beliefs: tuple[SavedBelief, ...]
    tables: Mapping[str, dict[str, NDArray[np.float64]]]


def is_team(data: Mapping[str, Any]) -> bool:
    """Whether a saved JSON object is of a task other than to reach a goal."""
    found: object = data
    for key in ("problem_file", "problem", "task"):
        found = cast("Mapping[str, object]", found).get(key) if isinstance(found, Mapping) else None
    return isinstance(found, str) and found != "reach"


def read_team(file: Path, data: Mapping[str, Any]) -> SavedTeam:
    """Read the files beside a JSON file.

    Raises
    ------
    InputError
        A file is missing, truncated or not what it should be; with file, key or row.
    """
    # What else must be there depends on the problem.
    problem = problem_from_dict(cast("dict[str, Any]", data["problem_file"]), file=file)
    record = record_of(file, data, TeamPlanRecord if file.name == PLAN_FILE else TeamRunRecord)
    if len(record.robots) != len(problem.robots):
        raise damaged(
            file, "robots", f"{len(record.robots)} robots, the problem has {len(problem.robots)}"
        )
    require_even(file, record.robots)
    table = read_steps(file.parent / STEPS_FILE, drive_columns(problem))
    require_rows(file, table, record.robots)
    ends = np.cumsum([0, *(len(robot.t_s) for robot in record.robots)]).tolist()
    steps = tuple(table.take(slice(begin, end)) for begin, end in pairwise(ends))
    if isinstance(record, TeamPlanRecord):
        beliefs = (read_belief(file.parent / BELIEF_FILE, len(problem.stations)),)
        return SavedTeam(file, data, record, problem, steps, beliefs, {})
    beliefs = tuple(
        read_belief(file.parent / name, len(problem.stations)) for name in belief_files(problem)
    )
    _require_complete_run(file, record, beliefs)
    return SavedTeam(
        file,
        data,
        record,
        problem,
        steps,
        beliefs,
        _read_tables(file, problem, len(steps[0].steps)),
    )


def _require_complete_run(
    file: Path, record: TeamRunRecord, beliefs: Sequence[SavedBelief]
) -> None:
    """Every robot was driven as long as the others, and each of its steps has plan and belief."""
    if len(record.plans) != len(record.robots):
        raise damaged(
            file, "plans", f"of {len(record.plans)} robots where there are {len(record.robots)}"
        )
    counts = [len(robot.t_s) for robot in record.robots]
    if min(counts) < max(counts) or counts[0] < 2:
        raise damaged(file, "robots", f"{counts} places, should be as many of each and at least 2")
    for number, (robot, belief) in enumerate(zip(record.plans, beliefs, strict=True)):
        key = f"plans[{number}].released"
        require_complete_robot(file, key, counts[0] - 1, robot.released, belief)


def _read_tables(
    file: Path, problem: Problem, rows: int
) -> dict[str, dict[str, NDArray[np.float64]]]:
    columns: dict[str, tuple[str, ...]] = {KNOWLEDGE_FILE: KNOWLEDGE_COLUMNS}
    if problem.targets and any(term.sensor is not None for term in problem.terms):
        columns[TARGET_FILE] = target_columns(problem)
    tables = {name: read_table(file.parent / name, wanted) for name, wanted in columns.items()}
    for name, table in tables.items():
        found = len(table["t_s"])
        if found != rows:
            raise InputError(
                f"has {found} rows where {file.name} has {rows} places of each robot",
                file=file.parent / name,
                remedy=REMEDY,
            )
    return tables
