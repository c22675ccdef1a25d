"""The parts that all tasks share: results, their files, and how these are checked."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, cast

import numpy as np
from pydantic import Field

from planopt.errors import A_FOLDER, InputError, NoPlanError, path_of
from planopt.files.compare import differences, in_words
from planopt.files.tables import Column, Data, comparable, dataframe, read_table, write_tables
from planopt.files.typed_json import whole_number
from planopt.files.writing import Patterns, replaced_results, strict_text, write_text
from planopt.keys import Name, Table, located
from planopt.planning.files.saved import PLAN_FILE, PLAN_OR_RUN, RUN_FILE
from planopt.planning.loop.results import RunSummary, short_summary
from planopt.problems.settings import ReportSettings
from planopt.problems.tasks import TaskProblem, problem_from, task_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ANIMATION = "run.gif"

NO_PLAN, NOT_VERIFIED = 4, 3
"""Exit codes."""

Action = Literal["solve", "simulate"]


class HeadTable(Table):
    """``[problem]``: what the problem is called, and its task."""

    schema_version: Literal[1] = Field(alias="schema")
    """Version of this schema; it is 1."""
    name: Name
    """Name: letters, digits, '_' and '-'."""
    task: Name
    """Name of the task."""
    description: str = ""
    """One sentence for people."""


class ReportTable(Table):
    """``[report]``: what is drawn."""

    figures: bool = ReportSettings().figures
    """Draw figures (true or false)."""


class TaskFile(Table):
    """The tables that problem files of all tasks have; a task derives its own file from it."""

    problem: HeadTable
    report: ReportTable = Field(default_factory=ReportTable)


@dataclass(frozen=True, eq=False)
class Task:
    """A kind of problems: all that planopt knows about it.

    Attributes
    ----------
    model
        Model of the problem file, derived from :class:`planopt.extend.TaskFile`.
    build
        Makes the problem, a :class:`planopt.problems.TaskProblem`, of validated tables, the folder
        that relative file names start at, and the file (None if there is none). Raises an
        InputError for faults that single tables do not show. By default a plain ``TaskProblem``.
    solve, simulate
        Called with the problem, ``seed`` and further keyword arguments, ``simulate`` also with
        ``on_step``, which it calls after every step; each returns a
        :class:`planopt.extend.TaskResult` or raises a NoPlanError. None where the task has no such
        action. Arguments of :func:`planopt.solve` that are among their parameters are passed on,
        others go to `override`. With a parameter ``saved``, a check passes the saved tables: each
        step can then start from the saved state. Like `controller`, each may also be
        ``"module:name"``, imported when needed.
    override
        Called with the problem and keyword arguments such as ``horizon`` and ``planner``; returns
        the problem with these settings. None if there are none.
    controller
        Called with the problem, ``seed`` and keyword arguments as for `override`; returns what
        :class:`planopt.Planner` is for problems of the task. None if nothing is planned by steps.
    verify
        Returns the faults of a simulated result, found by a verifier that does not rely on the
        simulator. Called for every simulation, and by :func:`planopt.check`.
    reached
        Values of ``outcome`` of successful runs.
    summary
        Returns a result, of which ``value`` may be None, in lines of text.
    refusal
        Returns further keys of the JSON object where an action raised a NoPlanError, from the
        problem and the error.
    columns
        Columns of each table of a result, by file name.
    figures
        Returns figures of a result by file name, the most important one first.
    animate
        Writes an animation of a simulated result to a path; None if there is none.
    pictures
        All file names of `figures`.
    steps
        Returns how many steps a run takes at most, for progress display.
    """

    model: type[Table]
    build: Callable[[Any, Path, Path | None], Any] = lambda given, folder, file: TaskProblem(
        given, file
    )
    solve: Callable[..., Any] | str | None = None
    simulate: Callable[..., Any] | str | None = None
    override: Callable[..., Any] | None = None
    controller: Callable[..., Any] | str | None = None
    verify: Callable[[Any], Sequence[str]] | None = None
    reached: tuple[str, ...] = ()
    summary: Callable[[Any], Sequence[str]] | None = None
    refusal: Callable[[Any, NoPlanError], Mapping[str, Any]] | None = None
    columns: Mapping[str, Sequence[Column]] = field(default_factory=dict[str, Sequence[Column]])
    figures: Callable[[Any], Mapping[str, Any]] | None = None
    animate: Callable[[Any, Path], None] | None = None
    pictures: tuple[str, ...] = ()
    steps: Callable[[Any], int | None] = lambda problem: None

    says_ahead: ClassVar[bool] = False  # Whether `words_ahead` has anything to say

    def problem_from(self, tables: object, *, folder: Path, file: Path | None) -> Any:
        """Return the problem in tables, validated."""
        with located(self.model, file):
            return self.build(self.model.model_validate(tables), folder, file)

    def tables(self, problem: Any) -> dict[str, Any]:
        """Return a problem in full, as tables that can be read without other files."""
        return problem.tables()

    def words(self, problem: Any) -> Sequence[str]:
        """Return a problem in lines of text."""
        return problem.words()

    def warnings(self, problem: Any) -> Sequence[str]:
        """Return implausible values of a problem."""
        return ()

    def validated(self, problem: Any) -> dict[str, Any]:
        """Return further keys of ``planopt validate``."""
        return {}

    def has_figures(self, problem: Any) -> bool:
        """Return whether a problem asks for figures."""
        return problem.has_figures

    def words_ahead(self, problem: Any, plans: Any) -> Iterable[str]:
        """Return lines of text before the first step of a run."""
        return ()

    def report(self, result: Any) -> Any:
        """Return a result as the command line shows it, with the members of a TaskResult."""
        return result

    def no_plan(self, action: Action, problem: Any, seed: int, error: NoPlanError) -> Any:
        """Return the report of an action that found no plan."""
        planner = getattr(problem.given, "planner", None)
        data: dict[str, Any] = {
            "problem": problem.name,
            "horizon": getattr(planner, "horizon", None),
            "planner": getattr(planner, "name", None),
            "seed": seed,
            **({"verdict": "none"} if action == "solve" else {"outcome": "no_plan"}),
            "message": str(error),
            "wall_s": None,
        }
        more: Mapping[str, Any] = {} if self.refusal is None else self.refusal(problem, error)
        return TaskResult(problem, {**data, **more})

    def function(self, name: str) -> Callable[..., Any] | None:
        """Return ``solve``, ``simulate`` or ``controller``, imported if need be."""
        found = getattr(self, name)
        if isinstance(found, str):
            module, _, attribute = found.partition(":")
            return getattr(import_module(module), attribute)
        return found

    def labels(self, problem: Any) -> tuple[int, str, str | None]:
        """Return horizon, planner and cost-to-go, by which comparisons name a setting."""
        table = getattr(problem.given, "planner", None)
        return getattr(table, "horizon", 1), getattr(table, "name", ""), None

    def has_horizon(self, problem: Any) -> bool:
        """Return whether runs depend on the horizon."""
        return True

    def compared_costs_to_go(self, problem: Any) -> Sequence[str | None]:
        """Return the costs-to-go that are compared by default; None keeps the problem's own."""
        return (None,)

    def shared(self, problem: Any, seed: int) -> Any:
        """Return the data that runs of one seed share, whatever their settings."""
        return None

    def run_summary(self, problem: Any, seed: int, shared: Any) -> RunSummary:
        """Simulate a problem and return the summary of the run, for comparisons."""
        result: TaskResult = perform("simulate", problem, seed=seed)
        data, rate = result.data, result.data.get("verified_rate")
        reason = str(data.get("reason", data.get("message", "")))
        labels = self.labels(problem)
        return replace(
            short_summary(labels, seed, data["outcome"], reason, result.exit_code),
            metrics=_numbers(data.get("metrics", {})),
            rungs={str(name): int(count) for name, count in data.get("rungs", {}).items()},
            verified_rate=np.nan if rate is None else float(rate),
            step_s=np.asarray(result.step_s, dtype=float),
        )

    def act(self, action: Action, problem: Any, *, seed: int = 0, **settings: Any) -> Any:
        """Return the result of an action under settings; those that are None are left out."""
        function = self.function(action)
        if function is None:
            known = [name for name in ("solve", "simulate") if getattr(self, name) is not None]
            raise InputError(
                f"{problem.name} asks for {problem.task}, which there is no {action} for",
                file=problem.file,
                key="problem.task",
                remedy=f"use {', '.join(known)}",
            )
        given = {name: value for name, value in settings.items() if value is not None}
        known = signature(function).parameters
        problem = self.overridden(problem, **{k: v for k, v in given.items() if k not in known})
        return function(problem, seed=seed, **{k: v for k, v in given.items() if k in known})

    def control(self, problem: Any, *, seed: int = 0, **settings: Any) -> Any:
        """Return the controller of a problem under settings; those that are None are left out."""
        function = self.function("controller")
        if function is None:
            raise InputError(
                f"{problem.name} asks for {problem.task}, which has no steps to plan",
                file=problem.file,
                key="problem.task",
                remedy="use planopt.solve",
            )
        return function(self.overridden(problem, **settings), seed=seed)

    def overridden(self, problem: Any, **settings: Any) -> Any:
        """Return a problem under other settings; those that are None are left out."""
        given = {name: value for name, value in settings.items() if value is not None}
        known = () if self.override is None else signature(self.override).parameters
        for name in given:
            if name not in known:
                raise InputError(
                    f"is not for the task {problem.task}", key=name, remedy="leave it out"
                )
        return problem if self.override is None else self.override(problem, **given)


def _numbers(metrics: Mapping[str, Any]) -> dict[str, float]:
    """Return metrics as numbers; names of nested tables are joined by an underscore."""
    found: dict[str, float] = {}
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            parts = _numbers(cast("Mapping[str, Any]", value))
            found |= {f"{name}_{key}": part for key, part in parts.items()}
        else:
            found[name] = np.nan if value is None else float(value)
    return found


@dataclass(frozen=True, eq=False)
class TaskResult:
    """Result of :func:`planopt.solve` or :func:`planopt.simulate` for a problem of a task.

    Attributes
    ----------
    problem
        As solved or simulated (other settings applied).
    data
        The JSON object. It has a ``verdict`` (``verified``, ``violated`` or ``none``) if the
        problem was solved, an ``outcome`` if it was simulated.
    tables
        Columns by file name and column, as the task declares them.
    value
        An object of the task's own; None for a result that was read.
    step_s
        Wall time of each step of a simulation.
    """

    problem: TaskProblem
    data: Mapping[str, Any]
    tables: Mapping[str, Data] = field(default_factory=dict[str, Data])
    value: Any = None
    step_s: Sequence[float] = ()

    def __repr__(self) -> str:
        """Return the result in lines of text."""
        return "\n".join(self.words)

    @property
    def task(self) -> Task:
        """Return the task of the problem."""
        return task_of(self.problem)

    @property
    def words(self) -> tuple[str, ...]:
        """Return the result in lines of text."""
        name, end = self.problem.name, self.data.get("outcome", self.data.get("verdict"))
        if self.exit_code == NO_PLAN and end in ("none", "no_plan"):
            return (f"{name}: no plan: {self.data.get('message') or self.data.get('reason')}",)
        summary = self.task.summary
        lines = (f"{name}: {end}",) if summary is None else summary(self)
        return (*lines, *(f"  {fault}" for fault in self.data.get("faults", ())))

    @property
    def exit_code(self) -> int:
        """Return 0 if verified, 3 if not, 4 if there is no plan or a run did not do its task."""
        if "verdict" in self.data:
            return {"verified": 0, "none": NO_PLAN}.get(self.data["verdict"], NOT_VERIFIED)
        if self.data.get("outcome") not in self.task.reached:
            return NO_PLAN
        return NOT_VERIFIED if self.data.get("faults") else 0

    @property
    def files(self) -> Patterns:
        """Return the names of all files that results of the task, or of motion planning, have."""
        return (*PLAN_OR_RUN, *self.task.columns, *self.task.pictures)

    def save(self, folder: Path | str) -> None:
        """Save the result as a folder that :func:`planopt.check` and ``load_result`` read.

        Parameters
        ----------
        folder
            Made if it is missing; a result that it had is replaced.

        Raises
        ------
        OutputError
            The folder cannot be written; what it had is still there.
        """
        file = RUN_FILE if "outcome" in self.data else PLAN_FILE
        columns = self.task.columns
        with replaced_results(path_of("folder", folder, A_FOLDER), self.files) as new:
            write_tables(new, {name: (columns[name], data) for name, data in self.tables.items()})
            record = {**self.data, "problem_file": self.problem.tables()}
            write_text(new / file, strict_text(record))

    def to_dataframe(self, table: str = "steps.csv") -> Any:
        """Return a table as a pandas DataFrame.

        Raises
        ------
        InputError
            There is no such table, or pandas is not installed.
        """
        if table not in self.tables:
            known = ", ".join(self.tables) or "no table"
            raise InputError(f"is {table!r}", key="table", remedy=f"there is {known}")
        return dataframe(self.task.columns[table], self.tables[table])

    def plot(self) -> Figure:
        """Draw the result; no window is opened.

        Raises
        ------
        InputError
            The task has no figures, or the result was read from files.
        """
        figures = self.task.figures
        if figures is None or self.value is None:
            raise InputError("there is no figure", key="plot", remedy="solve or simulate again")
        return next(iter(figures(self).values()))

    def draw(self, folder: Path, *, animation: bool = False) -> None:
        """Draw the figures that the problem asks for, and an animation on request."""
        from planopt.report import save_figure

        task = self.task
        if self.value is None:
            return
        if task.figures is not None and self.problem.has_figures:
            for name, figure in task.figures(self).items():
                save_figure(figure, folder / name)
        if task.animate is not None and animation:
            task.animate(self, folder / ANIMATION)


def perform(
    action: Action,
    problem: Any,
    *,
    seed: int = 0,
    on_step: Callable[..., object] | None = None,
    **settings: Any,
) -> Any:
    """Solve or simulate a problem of any task; results of other tasks are timed and verified."""
    task = task_of(problem)
    ends_s = [time.perf_counter()]

    def after_step(*step: int) -> None:
        ends_s.append(time.perf_counter())
        if on_step is not None:
            on_step(*step)

    if action == "simulate":
        settings["on_step"] = after_step
    result = task.act(action, problem, seed=seed, **settings)
    if not isinstance(result, TaskResult):
        return result
    data = {"problem": problem.name, "seed": seed, **result.data}
    data["wall_s"] = time.perf_counter() - ends_s[0]
    if action == "simulate":
        lasts_s = np.diff(ends_s)
        levels = ("p50", "p95", "max")
        shares = np.percentile(lasts_s, [50, 95, 100]).tolist() if len(lasts_s) else None
        data["step_s"] = None if shares is None else dict(zip(levels, shares, strict=True))
        if task.verify is not None:
            data["faults"] = list(task.verify(result))
            data.setdefault("verified_rate", 0.0 if data["faults"] else 1.0)
    return replace(result, data=data, step_s=np.diff(ends_s).tolist())


def read_result(file: Path, data: Mapping[str, Any]) -> TaskResult:
    """Return a saved result, of which the JSON object has been read."""
    problem = problem_from(data.get("problem_file"), folder=file.absolute().parent, file=file)
    columns = task_of(problem).columns
    names = [name for name in columns if (file.parent / name).is_file()]
    tables = {name: read_table(file.parent / name, columns[name]) for name in names}
    kept = {key: value for key, value in data.items() if key != "problem_file"}
    return TaskResult(problem, kept, tables)


def reasons_against(file: Path, data: Mapping[str, Any]) -> list[str]:
    """Return what is wrong with a saved result: it is computed again, verified, and compared.

    A task whose verifier does not trust its simulator has ``verify`` called on the new result.
    """
    saved = read_result(file, data)
    seed = whole_number(file, data, "seed")
    if saved.data.get("outcome") == "no_plan" or saved.data.get("verdict") == "none":
        return [f"there is nothing to check: {saved.words[0]}"]
    action: Action = "solve" if file.name == PLAN_FILE else "simulate"
    try:
        follows = "saved" in signature(task_of(saved.problem).function(action)).parameters
        more: dict[str, Any] = {"saved": saved.tables} if follows and saved.tables else {}
        again: TaskResult = perform(action, saved.problem, seed=seed, **more)
    except NoPlanError as error:
        return [f"{file.name}: there is no plan: {error}"]
    reasons: list[str] = []
    for name, table in again.tables.items():
        if name not in saved.tables:
            raise InputError("there is no such file", file=file.parent / name)
        found = differences(comparable(saved.tables[name]), comparable(table))
        reasons += in_words(name, found)
    return reasons + in_words(file.name, differences(saved.data, again.data))
