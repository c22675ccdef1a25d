"""Load a problem from a file or by the name of a library problem."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from pathlib import Path
from typing import cast

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
from planopt.problems.tables import Table

SYSTEMS = {
    "pursuit": "planopt.systems.pursuit.system",
    "pursuit_design": "planopt.systems.pursuit_design.system",
}
"""The module of each system, by task; its attribute ``SYSTEM`` is the :class:`System`."""


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
    with located(ProblemFile, file):
        problem = build(ProblemFile.model_validate(data), folder, file)
        check(problem)
    return problem


@contextlib.contextmanager
def located(model: type[Table], file: Path | None) -> Generator[None]:
    """Turn what validating tables of `model` raises into errors that name the key and the file."""
    try:
        yield
    except ValidationError as error:
        raise input_error(error, model, file=file) from None
    except InputError as error:
        raise error if file is None else error.located(file) from None


def task_of_system(data: object) -> str | None:
    """Return the task in the tables of a problem file if it is a system's."""
    task = _entry(_entry(data, "problem"), "task")
    return task if isinstance(task, str) and task in SYSTEMS else None


def _entry(table: object, key: str) -> object:
    """An entry of what may be no table at all."""
    return cast("dict[str, object]", table).get(key) if isinstance(table, dict) else None
