"""Registry of tasks: built-in ones, and those of the entry-point group ``planopt.tasks``."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Self, cast

from planopt.errors import InputError
from planopt.keys import located
from planopt.parts import Registry
from planopt.short_repr import short_repr
from planopt.world.workspace import Obstacle

GROUP = "planopt.tasks"
"""Entry-point group of external tasks."""
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
        """Return the complete tables of the problem, which refer to no other files."""
        return self.config.model_dump(mode="json", by_alias=True, exclude_none=True)

    def words(self) -> Sequence[str]:
        """Return a text summary of the problem, line by line."""
        return (f"{self.name}: {self.description}", f"  task        {self.task}")

    def with_planner(self, horizon: int | None = None, planner: str | None = None) -> Self:
        """Return the problem with another planner; planners without look-ahead have horizon 1."""
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
    name = _entry(_entry(tables, "problem"), "task")
    # A task that is not text fails validation by the motion planning model.
    return name if isinstance(name, str) else MOTION[0]


def _entry(table: object, key: str) -> object:
    """Return a table's entry; None if it is missing or the object is not a table."""
    return cast("dict[str, object]", table).get(key) if isinstance(table, dict) else None


def problem_from(tables: object, *, folder: Path, file: Path | None) -> Any:
    """Build a validated problem of any task from tables."""
    try:
        task = task_named(named_task(tables))
    except InputError as error:
        raise error if file is None else error.located(file) from None
    return task.problem_from(tables, folder=folder, file=file)
