"""Registry of tasks (built-in, and of the entry-point group ``planopt.tasks``), and results."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from planopt.errors import A_FOLDER, InputError, path_of
from planopt.files.compare import differences, in_words
from planopt.files.tables import Column, Data, comparable, dataframe, table_text
from planopt.files.writing import replaced_results, strict_text, write_text, write_whole
from planopt.keys import located
from planopt.parts import Registry
from planopt.short_repr import short_repr
from planopt.world.workspace import Obstacle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GROUP = "planopt.tasks"  # Entry-point group of external tasks
MOTION = ("reach", "track", "learn", "map", "connect", "custom")
"""Tasks of motion planning, which share their tables; the first one is the default."""
OWN = {
    **dict.fromkeys(MOTION, "planopt.tasks.motion:TASK"),
    "coverage": "planopt.tasks.coverage:TASK",
    "pursuit": "planopt.tasks.pursuit:TASK",
    "pursuit_design": "planopt.tasks.pursuit_design:TASK",
}
"""Import paths of the built-in tasks, imported on demand."""


LOOKING_AHEAD = "receding"
"""Planner of tasks other than motion planning whose plans depend on the horizon."""

TASKS = Registry("a task", "problem.task", OWN, GROUP)


@dataclass(frozen=True, eq=False)
class TaskProblem:
    """Base class of problems of tasks other than motion planning.

    Attributes
    ----------
    config
        Validated tables of the problem file.
    file
        Source file, or None.
    """

    config: Any = field(repr=False)
    file: Path | None

    has_goal: ClassVar[bool] = False

    __repr__ = short_repr

    @property
    def name(self) -> str:
        """Name of the problem."""
        return self.config.problem.name

    @property
    def task(self) -> str:
        """Name of the problem's task."""
        return self.config.problem.task

    @property
    def description(self) -> str:
        """Return the one-sentence description of the problem."""
        return self.config.problem.description

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Return the obstacles in the table ``world``; empty for a task without it."""
        return getattr(getattr(self.config, "world", None), "obstacles", ())

    @property
    def has_figures(self) -> bool:
        """Return True if figures are drawn (key ``report.figures``)."""
        return self.config.report.figures

    def tables(self) -> dict[str, Any]:
        """Return the complete tables of the problem, without references to other files."""
        return self.config.model_dump(mode="json", by_alias=True, exclude_none=True)

    def words(self) -> Sequence[str]:
        """Return a text summary of the problem, line by line."""
        return (f"{self.name}: {self.description}", f"  task        {self.task}")

    def with_planner(self, horizon: int | None = None, planner: str | None = None) -> Self:
        """Return the problem with a changed planner; planners without look-ahead get horizon 1."""
        now = self.config.planner
        model = cast("Any", type(now))
        changes = {"horizon": horizon, "name": planner}
        changed = {name: value for name, value in changes.items() if value is not None}
        with located(model, None, "planner"):
            table = model.model_validate({**now.model_dump(), **changed})
        if table.name != LOOKING_AHEAD:
            table = table.model_copy(update={"horizon": 1})
        return replace(self, config=self.config.model_copy(update={"planner": table}))


def task_named(name: object) -> Any:
    """Return the :class:`planopt.tasks.task.Task` with a name."""
    found = TASKS.find(name)
    if not hasattr(found, "problem_from"):
        raise InputError(
            f"is {name}, but its entry point is of type {type(found).__name__}, should be a "
            "planopt.extend.Task",
            key="problem.task",
            remedy="correct the entry point of the package",
        )
    return found


def task_of(problem: object) -> Any:
    """Return the :class:`planopt.tasks.task.Task` of a problem."""
    if not isinstance(problem, TaskProblem) and getattr(problem, "task", None) not in MOTION:
        kind = (
            f"the class {problem.__name__}"
            if isinstance(problem, type)
            else f"of type {type(problem).__name__}"
        )
        raise InputError(
            f"is {kind}, should be a problem",
            key="problem",
            remedy="use planopt.load, or create a Problem",
        )
    return task_named(cast("Any", problem).task)


def named_task(tables: object) -> str:
    """Return the name of the task in a problem file's tables; default: the first of `MOTION`."""
    # A task that is not text fails validation by the motion planning model.
    match tables:
        case {"problem": {"task": str() as name}}:
            return name
        case _:
            return MOTION[0]


def problem_from(tables: object, *, folder: Path, file: Path | None) -> Any:
    """Build a validated problem of any task from tables."""
    try:
        task = task_named(named_task(tables))
    except InputError as error:
        raise error if file is None else error.located(file) from None
    return task.problem_from(tables, folder=folder, file=file)


Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Contents:
    """Contents of all files of a result, except for the problem."""

    file: str  # Name of the JSON file
    data: Mapping[str, Any]
    # Columns and values by file name
    tables: Mapping[str, tuple[Sequence[Column], Data]] = field(
        default_factory=dict[str, tuple[Sequence[Column], Data]]
    )
    arrays: Mapping[str, Arrays] = field(default_factory=dict[str, Arrays])  # By file name

    def table_reasons(self, saved: Mapping[str, Data]) -> list[str]:
        """Return the differences of saved tables from the recomputed ones, line by line."""
        return [
            line
            for name, (_, data) in self.tables.items()
            for line in in_words(name, differences(comparable(saved[name]), comparable(data)))
        ]


@dataclass(frozen=True, eq=False, repr=False)
class Result(ABC):
    """Result of :func:`planopt.solve` or :func:`planopt.simulate` for a problem of any task."""

    problem: Any

    @property
    @abstractmethod
    def exit_code(self) -> int:
        """Return the exit code of the command line."""

    def __repr__(self) -> str:
        """Return a text summary of the result, line by line."""
        return "\n".join(self.words)

    @property
    def task(self) -> Any:
        """Return the :class:`planopt.extend.Task` of the problem."""
        return task_of(self.problem)

    @property
    def words(self) -> tuple[str, ...]:
        """Return a text summary of the result, line by line."""
        return tuple(self.task.result_words(self))

    def save(self, folder: Path | str) -> None:
        """Save the result to a folder that :func:`planopt.check` and ``load_result`` can read.

        Parameters
        ----------
        folder
            Folder, created if missing; a previous result in it is replaced.

        Raises
        ------
        OutputError
            The folder cannot be written; its previous content is kept.
        InputError
            The problem has parts from Python, which cannot be saved.
        """
        files: Contents = self.task.contents(self)
        with replaced_results(path_of("folder", folder, A_FOLDER), self.task.files) as new:
            for name, arrays in files.arrays.items():
                write_whole(new / name, partial(np.savez_compressed, allow_pickle=False, **arrays))
            for name, table in files.tables.items():
                write_text(new / name, table_text(*table))
            record = {**files.data, "problem_file": self.task.tables(self.problem)}
            write_text(new / files.file, strict_text(record))

    def draw(self, folder: Path, *, animation: bool = False) -> None:
        """Write the figures selected by the problem, and optionally an animation."""
        self.task.draw(self, folder, animation=animation)

    def plot(self) -> Figure:
        """Return the main figure of the result without opening a window.

        Returns
        -------
        matplotlib.figure.Figure
            Figure; ``figure.savefig("result.png")`` writes it.

        Raises
        ------
        InputError
            The task has no figures, or needs data that are not saved.
        """
        figure = self.task.main_figure(self)
        if figure is None:
            raise InputError(
                "is not available: the task has no figure, or the result was read from files",
                key="plot",
                remedy="solve or simulate again",
            )
        return figure

    def _repr_html_(self) -> str:
        """Return HTML for notebooks: the main figure, if any, and key figures."""
        summary_html = import_module("planopt.report.page_content").summary_html
        task = self.task
        return summary_html(self.problem.name, task.key_figures(self), task.main_figure(self))

    def to_dataframe(self, table: str = "steps.csv") -> Any:
        """Return a table as a pandas DataFrame.

        Parameters
        ----------
        table
            File name of the table. For motion planning, ``steps.csv`` has a row per position of
            each robot, the start first; columns of the ground truth are empty for a plan.

        Returns
        -------
        pandas.DataFrame
            One column per column of the file.

        Raises
        ------
        InputError
            The table does not exist, or pandas is not installed.
        """
        tables: Mapping[str, tuple[Sequence[Column], Data]] = self.task.contents(self).tables
        if table not in tables:
            raise InputError(
                f"is {table!r}, which is not a table of this result",
                key="table",
                remedy=f"use {', '.join(tables) or 'no table'}",
            )
        return dataframe(*tables[table])
