"""Base classes of all tasks: problem-file tables, actions, results and their checks."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from inspect import signature
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Any, ClassVar, Literal, cast, get_args

import numpy as np

from planopt.arrays import require_seed
from planopt.errors import InputError, NoPlanError
from planopt.files.compare import BOUNDED, REPEATED, differences, in_words
from planopt.files.tables import Column, Data, finite, read_table, seed_in
from planopt.files.writing import Patterns
from planopt.keys import Table, located
from planopt.planning.check.check import CheckResult, gap_reasons
from planopt.planning.files.saved import PLAN_FILE, PLAN_OR_RUN, RUN_FILE, read_object
from planopt.planning.loop.results import RunSummary
from planopt.planning.plan import Verdict
from planopt.problems.tasks import Contents, Result, TaskProblem, problem_from, task_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from planopt.report.page import Page

ANIMATION = "run.gif"

NO_PLAN, NOT_VERIFIED = 4, 3  # Exit codes of the command line
MOST_REASONS = 3  # Maximum number of faults in a row of the regression suite
EFFORT_KEYS = ("prove_s",)  # Keys of a saved result that a check passes to the action again

Action = Literal["solve", "simulate"]


@dataclass(frozen=True, eq=False)
class Task:
    """Task: a class of problems with its file format, actions and outputs.

    Attributes
    ----------
    model
        Model of the problem file, derived from :class:`planopt.extend.TaskFile`.
    build
        Function that builds a :class:`planopt.problems.TaskProblem` from validated tables, the
        folder that relative file names refer to, and the file (or None). It raises an InputError
        for faults across tables. The default builds a plain ``TaskProblem``.
    solve, simulate
        Functions of the problem, ``seed`` and keyword arguments that return a
        :class:`planopt.extend.TaskResult` or raise a NoPlanError; None if the task has no such
        action. ``simulate`` also takes ``on_step`` and calls it after every step. Arguments of
        :func:`planopt.solve` that the function accepts are passed to it, others to `override`. If
        it has a parameter ``saved``, a check passes the saved tables, and each step can start from
        the saved state. Like `controller`, each may be a string ``"module:name"``, imported on
        demand.
    override
        Function of the problem and keyword arguments such as ``horizon`` and ``planner`` that
        returns the problem with these settings; None if the task has no such settings.
    controller
        Function of the problem, ``seed`` and the keyword arguments of `override` that returns the
        task's counterpart of :class:`planopt.Planner`; None if the task does not plan stepwise.
    verify
        Function that returns the faults of a simulated result, found independently of the
        simulator. It is called for every simulation and by :func:`planopt.check`.
    reached
        Values of ``outcome`` that mark a successful run.
    criterion
        Metric by which the regression suite compares runs, and ``min`` or ``max``.
    summary
        Function that returns a text summary of a result, whose ``value`` may be None.
    refusal
        Function of the problem and a NoPlanError that returns additional keys of the JSON
        object.
    columns
        Columns of each table of a result by file name.
    figures
        Function that returns the figures of a result by file name, most important first.
    animate
        Function that writes an animation of a simulated result to a path, or None.
    pictures
        File names that `figures` may return.
    steps
        Function that returns the maximum number of steps of a run, for progress display.
    """

    model: type[Table]
    build: Callable[[Any, Path, Path | None], Any] = lambda config, folder, file: TaskProblem(
        config, file
    )
    solve: Callable[..., Any] | str | None = None
    simulate: Callable[..., Any] | str | None = None
    override: Callable[..., Any] | None = None
    controller: Callable[..., Any] | str | None = None
    verify: Callable[[Any], Sequence[str]] | None = None
    reached: tuple[str, ...] = ()
    criterion: tuple[str, Literal["min", "max"]] = ("", "min")
    summary: Callable[[Any], Sequence[str]] | None = None
    refusal: Callable[[Any, NoPlanError], Mapping[str, Any]] | None = None
    columns: Mapping[str, Sequence[Column]] = field(default_factory=dict[str, Sequence[Column]])
    figures: Callable[[Any], Mapping[str, Any]] | None = None
    animate: Callable[[Any, Path], None] | None = None
    pictures: tuple[str, ...] = ()
    steps: Callable[[Any], int | None] = lambda problem: None

    says_ahead: ClassVar[bool] = False  # Whether `words_ahead` may return text
    plans_ahead: ClassVar[bool] = False  # Whether `solve` depends on horizon and planner

    @property
    def files(self) -> Patterns:
        """Return patterns of all file names that a result of the task may have."""
        return (*PLAN_OR_RUN, *self.columns, *self.pictures)

    def problem_from(self, tables: object, *, folder: Path, file: Path | None) -> Any:
        """Build a validated problem from tables."""
        with located(self.model, file):
            return self.build(
                self.model.model_validate(tables, context={"folder": folder}), folder, file
            )

    def tables(self, problem: Any) -> dict[str, Any]:
        """Return the complete tables of a problem, without references to other files."""
        return problem.tables()

    def words(self, problem: Any) -> Sequence[str]:
        """Return a text summary of a problem, line by line."""
        return problem.words()

    def warnings(self, problem: Any) -> Sequence[str]:
        """Return warnings about implausible values of a problem."""
        return ()

    def validated(self, problem: Any) -> dict[str, Any]:
        """Return additional JSON keys of ``planopt validate``."""
        return {}

    def has_figures(self, problem: Any) -> bool:
        """Return True if a problem enables figures."""
        return problem.has_figures

    def words_ahead(self, problem: Any, plans: Any) -> Iterable[str]:
        """Return text to print before the first step of a run."""
        return ()

    def result_words(self, result: Any) -> Sequence[str]:
        """Return a text summary of a result, line by line."""
        name, data = result.problem.name, result.data
        end = data.get("outcome", data.get("verdict"))
        if result.exit_code == NO_PLAN and end in ("none", "no_plan"):
            return (f"{name}: no plan: {data.get('message') or data.get('reason')}",)
        lines = (f"{name}: {end}",) if self.summary is None else self.summary(result)
        return (*lines, *(f"  {fault}" for fault in data.get("faults", ())))

    def contents(self, result: Any) -> Contents:
        """Return the contents of the files of a result."""
        tables = {name: (self.columns[name], data) for name, data in result.tables.items()}
        return Contents(RUN_FILE if "outcome" in result.data else PLAN_FILE, result.data, tables)

    def main_figure(self, result: Any) -> Figure | None:
        """Return the most important figure of a result; None if there is none."""
        if self.figures is None or result.value is None:
            return None
        return next(iter(self.figures(result).values()))

    def key_figures(self, result: Any) -> Iterable[tuple[str, object]]:
        """Return names and values of the key figures of a result."""
        end = "verdict" if "verdict" in result.data else "outcome"
        numbers = _scalars(result.data) | _scalars(result.data.get("metrics", {}))
        return [(end, result.data.get(end)), *numbers.items()]

    def explained(self, result: Any) -> Any:
        """Return the result, with an explanation to print if the task has one."""
        return result

    def draw(self, result: Any, folder: Path, *, animation: bool = False) -> None:
        """Draw the figures selected by the problem, and optionally an animation."""
        from planopt.report import save_figure

        if self.figures is not None and self.has_figures(result.problem):
            for name, figure in self.figures(result).items():
                save_figure(figure, folder / name)
        if self.animate is not None and animation:
            self.animate(result, folder / ANIMATION)

    def page(self, result: Any) -> Page:
        """Return the content of the HTML page of a result."""
        from planopt.report.page_content import task_page

        return task_page(result)

    def no_plan(self, action: Action, problem: Any, seed: int, error: NoPlanError) -> Any:
        """Return the result of an action for which no plan exists."""
        planner = getattr(problem.config, "planner", None)
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
        """Return ``solve``, ``simulate`` or ``controller``, imported if needed; None if missing."""
        found = getattr(self, name)
        if isinstance(found, str):
            module, _, attribute = found.partition(":")
            return getattr(import_module(module), attribute)
        return found

    def labels(self, problem: Any) -> tuple[int, str, str | None]:
        """Return horizon, planner and cost-to-go, the labels of a setting in comparisons."""
        table = getattr(problem.config, "planner", None)
        return getattr(table, "horizon", 1), getattr(table, "name", ""), None

    def has_horizon(self, problem: Any) -> bool:
        """Return True if runs depend on the horizon."""
        return True

    def compared_costs_to_go(self, problem: Any) -> Sequence[str | None]:
        """Return the costs-to-go compared by default; None means the problem's own."""
        return (None,)

    def shared(self, problem: Any, seed: int) -> Any:
        """Return data that all runs of one seed share, independent of their settings."""
        return None

    def run_summary(self, problem: Any, seed: int, shared: Any) -> RunSummary:
        """Simulate a problem, or solve it if it has no runs; return a summary for comparisons."""
        simulated = self.simulate is not None
        result: TaskResult = perform("simulate" if simulated else "solve", problem, seed=seed)
        data = result.data
        rate = data.get("verified_rate") if simulated else float(result.exit_code == 0)
        reason = str(data.get("reason", data.get("message", "")))
        outcome = data["outcome"] if simulated else data["verdict"]
        return RunSummary(
            *self.labels(problem),
            seed,
            outcome,
            reason,
            result.exit_code,
            metrics=_numbers(data.get("metrics", {}) if simulated else _scalars(data)),
            rungs={str(name): int(count) for name, count in data.get("rungs", {}).items()},
            verified_rate=np.nan if rate is None else float(rate),
            step_s=np.asarray(result.step_s, dtype=float),
        )

    def planners(self, problem: Any, kind: str) -> Sequence[str]:
        """Return the planners of the regression suite, or the task's name for its solver."""
        if self.function("solve" if kind == "plan" else "simulate") is None:
            return ()
        table: Table | None = getattr(problem.config, "planner", None)
        if kind == "plan" or table is None:
            return (problem.task,)
        known = get_args(type(table).model_fields["name"].annotation)
        return [name for name in known if self._allows(problem, name)]

    def _allows(self, problem: Any, planner: str) -> bool:
        """Return True if a planner accepts a problem."""
        try:
            self.overridden(problem, planner=planner)
        except InputError:
            return False
        return True

    def answer(
        self,
        problem: Any,
        kind: str,
        seed: int,
        shared: Any,
        states: Any = (),
        prove_s: float = 0.0,
    ) -> dict[str, Any]:
        """Return the regression suite's row for a plan, checked from its files, or for a run."""
        begun = process_time()
        function = self.function("solve" if kind == "plan" else "simulate")
        proves = bool(prove_s and function and "prove_s" in signature(function).parameters)
        more: dict[str, Any] = {"prove_s": prove_s} if proves else {}
        action: Action = "solve" if kind == "plan" else "simulate"
        result: TaskResult = perform(action, problem, seed=seed, **more)
        cpu_s = process_time() - begun
        data, steps = result.data, max(len(result.step_s), 1)
        name, sense = self.criterion
        objective = _numbers(data.get("metrics", {})).get(name, data.get("objective"))
        verdicts = {0: Verdict.VERIFIED, NOT_VERIFIED: Verdict.VIOLATED}
        row = {
            "outcome": "planned",
            "verdict": data.get("verdict", verdicts.get(result.exit_code, Verdict.NONE).value),
            "termination": data.get("termination", data.get("outcome", "")),
            "objective": None if objective is None else finite(objective),
            "sense": data.get("sense", sense),
            "bound": data.get("bound"),
            "gap": data.get("gap"),
            "reasons": tuple(data.get("faults", ()))[:MOST_REASONS],
            "rungs": {"plan": steps},
            "steps": steps,
            "cpu_s": cpu_s,
            "wall_s": data["wall_s"],
        }
        if kind != "plan":
            return row
        checked = checked_again(self, result)
        accepted = checked.verdict is Verdict.VERIFIED
        return {**row, "accepted": accepted, "reasons": checked.reasons}

    def check(self, file: Path, data: Mapping[str, Any]) -> CheckResult:
        """Recompute and verify a saved result whose JSON object is already loaded."""
        if data.get("outcome") == "no_plan" or data.get("verdict") == "none":
            message = data.get("message") or data.get("reason")
            return CheckResult(Verdict.NONE, (), (f"there is no plan to verify: {message}",))
        reasons = tuple(_reasons_against(file, data))
        return CheckResult(Verdict.VIOLATED if reasons else Verdict.VERIFIED, (), reasons)

    def load_result(self, file: Path, data: Mapping[str, Any]) -> Any:
        """Read a saved result whose JSON object is already loaded."""
        return _read_result(file, data)

    def act(self, action: Action, problem: Any, *, seed: int = 0, **settings: Any) -> Any:
        """Return the result of an action with settings; settings that are None are ignored."""
        require_seed(seed)
        function = self.function(action)
        if function is None:
            known = [name for name in ("solve", "simulate") if getattr(self, name) is not None]
            raise InputError(
                f"is {problem.task}, which does not support {action}",
                file=problem.file,
                key="problem.task",
                remedy=f"use {', '.join(known)}",
            )
        given = {name: value for name, value in settings.items() if value is not None}
        known = signature(function).parameters
        problem = self.overridden(problem, **{k: v for k, v in given.items() if k not in known})
        return function(problem, seed=seed, **{k: v for k, v in given.items() if k in known})

    def control(self, problem: Any, *, seed: int = 0, **settings: Any) -> Any:
        """Return the controller of a problem with settings; settings that are None are ignored."""
        require_seed(seed)
        function = self.function("controller")
        if function is None:
            raise InputError(
                f"is {problem.task}, which is not controlled step by step",
                file=problem.file,
                key="problem.task",
                remedy="use planopt.solve",
            )
        return function(self.overridden(problem, **settings), seed=seed)

    def overridden(self, problem: Any, **settings: Any) -> Any:
        """Return a problem with changed settings; settings that are None are ignored."""
        given = {name: value for name, value in settings.items() if value is not None}
        known = () if self.override is None else signature(self.override).parameters
        for name in given:
            if name not in known:
                raise InputError(
                    f"is not an option of the task {problem.task}", key=name, remedy="leave it out"
                )
        return problem if self.override is None else self.override(problem, **given)


def _numbers(metrics: Mapping[str, Any]) -> dict[str, float]:
    """Return metrics as a flat mapping to numbers; nested names are joined by an underscore."""
    found: dict[str, float] = {}
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            parts = _numbers(cast("Mapping[str, Any]", value))
            found |= {f"{name}_{key}": part for key, part in parts.items()}
        else:
            found[name] = np.nan if value is None else float(value)
    return found


def _scalars(data: Mapping[str, Any]) -> dict[str, float]:
    """Return the numeric values of a design or deployment as metrics for comparisons."""
    return {
        name: value
        for name, value in data.items()
        if isinstance(value, int | float) and name not in ("seed", "wall_s")
    }


def checked_again(task: Task, result: Any) -> CheckResult:
    """Return the check of a result after saving it to a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        result.save(folder)
        return task.check(*read_object(Path(folder)))


@dataclass(frozen=True, eq=False, repr=False)
class TaskResult(Result):
    """Result of :func:`planopt.solve` or :func:`planopt.simulate` for a problem of a task.

    Attributes
    ----------
    problem
        Problem as solved or simulated, with changed settings applied.
    data
        JSON object, with a ``verdict`` (``verified``, ``violated`` or ``none``) of ``solve`` or an
        ``outcome`` of ``simulate``.
    tables
        Arrays by file name and column, as declared by the task.
    value
        Task-specific result object; None for a result read from files.
    step_s
        Wall time of each simulation step in seconds.
    """

    problem: TaskProblem
    data: Mapping[str, Any]
    tables: Mapping[str, Data] = field(default_factory=dict[str, Data])
    value: Any = None
    step_s: Sequence[float] = ()

    @property
    def exit_code(self) -> int:
        """Return 0 if verified, 3 if not, 4 if no plan exists or a run failed its task."""
        if "verdict" in self.data:
            return {"verified": 0, "none": NO_PLAN}.get(self.data["verdict"], NOT_VERIFIED)
        if self.data.get("outcome") not in self.task.reached:
            return NO_PLAN
        return NOT_VERIFIED if self.data.get("faults") else 0

    def draw(self, folder: Path, *, animation: bool = False) -> None:
        """Draw the figures selected by the problem, unless the result was read from files."""
        if self.value is not None:
            super().draw(folder, animation=animation)


def perform(
    action: Action,
    problem: Any,
    *,
    seed: int = 0,
    on_step: Callable[..., object] | None = None,
    **settings: Any,
) -> Any:
    """Solve or simulate a problem of any task; add wall times and faults to a `TaskResult`."""
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


def _read_result(file: Path, data: Mapping[str, Any]) -> TaskResult:
    """Read a saved result whose JSON object is already loaded."""
    problem = problem_from(data.get("problem_file"), folder=file.absolute().parent, file=file)
    columns = task_of(problem).columns
    names = [name for name in columns if (file.parent / name).is_file()]
    tables = {name: read_table(file.parent / name, columns[name]) for name in names}
    kept = {key: value for key, value in data.items() if key != "problem_file"}
    return TaskResult(problem, kept, tables)


def _reasons_against(file: Path, data: Mapping[str, Any]) -> list[str]:
    """Recompute and verify a saved result; return its differences and faults."""
    saved = _read_result(file, data)
    seed = seed_in(file, data)
    action: Action = "solve" if file.name == PLAN_FILE else "simulate"
    try:
        follows = "saved" in signature(task_of(saved.problem).function(action)).parameters
        more: dict[str, Any] = {"saved": saved.tables} if follows and saved.tables else {}
        efforts = {key: saved.data[key] for key in EFFORT_KEYS if key in saved.data}
        again: TaskResult = perform(action, saved.problem, seed=seed, **more, **efforts)
    except NoPlanError as error:
        return [f"{file.name}: there is no plan: {error}"]
    for name in again.tables.keys() - saved.tables.keys():
        raise InputError("does not exist", file=file.parent / name)
    reasons = task_of(saved.problem).contents(again).table_reasons(saved.tables)
    tolerances = REPEATED if efforts else BOUNDED
    found = differences(saved.data, again.data, tolerances=tolerances)
    return reasons + in_words(file.name, found) + gap_reasons(again.data.get("gap"))
