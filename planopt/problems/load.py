"""Load a problem from a file or by the name of a library problem."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from planopt.errors import InputError, require_text
from planopt.problems.build import build
from planopt.problems.check_files import check_files
from planopt.problems.checks import check
from planopt.problems.library import find_problem
from planopt.problems.messages import input_error
from planopt.problems.problem import Problem
from planopt.problems.read_toml import read_toml
from planopt.problems.schema import ProblemFile


def load(path_or_name: Path | str) -> Problem:
    """Load a problem.

    Parameters
    ----------
    path_or_name
        The path of a TOML file, or the name of a library problem such as ``munich_courier``.

    Returns
    -------
    Problem
        Validated; file names in it are absolute, relative ones starting at the problem file.

    Raises
    ------
    InputError
        There is no such file or problem, it does not parse, a key is unknown or has a value that
        is not allowed, an obstacle is no polygon, a named file is missing, or a start or goal is
        not free.
    """
    from planopt.problems.systems import task_of_system  # imports this module

    path = find_problem(path_or_name)
    require_text(str(path.absolute()), "the path")
    data = read_toml(path)
    task = task_of_system(data)
    if task is not None:
        raise InputError(
            f"is {task}, which is no motion planning",
            file=path,
            key="problem.task",
            remedy="load it with planopt.load_system",
        )
    problem = problem_from_tables(data, folder=path.absolute().parent, file=path)
    check_files(problem)
    return problem


def problem_from_tables(data: object, *, folder: Path, file: Path | None) -> Problem:
    """The problem in the tables of the schema, validated and checked.

    Parameters
    ----------
    data
        Tables as ``tomllib`` or ``json`` give them.
    folder
        Relative file names start here.
    file
        Where they came from, for messages.

    Raises
    ------
    InputError
        As :func:`load`, except that the truth's map and the log need not be there.
    """
    try:
        tables = ProblemFile.model_validate(data)
    except ValidationError as error:
        raise input_error(error, ProblemFile, file=file) from None
    try:
        problem = build(tables, folder, file)
        check(problem)
    except InputError as error:
        raise error if file is None else error.located(file) from None
    return problem
