"""Systems: kinds of problems beside motion planning, with tables and answers of their own.

``[problem] task`` names the kind. A system is one :class:`System` in a module of its own, imported
when a problem of its task is met; a new one needs its module and an entry in `SYSTEMS`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

from planopt.errors import InputError, NoPlanError
from planopt.problems.library import find_problem
from planopt.problems.load import SYSTEMS, task_of_system
from planopt.problems.load import load as load_motion
from planopt.problems.messages import located
from planopt.problems.problem import Problem
from planopt.problems.read_toml import read_toml
from planopt.problems.settings import MAX_HORIZON, MIN_HORIZON
from planopt.problems.tables import Table
from planopt.short_repr import short_repr

ACTIONS = ("solve", "simulate")
"""What may be asked of a system; each has some of them."""


@dataclass(frozen=True)
class Request:
    """A request to a system."""

    seed: int = 0  # Of everything random
    # In place of the problem's own; empty for these. solve and simulate take one each.
    horizons: Sequence[int] = ()
    planners: Sequence[str] = ()
    on_step: Callable[[], None] = lambda: None  # Called after every step of a run
    animation: bool = False  # Whether a run is drawn as an animation as well


AnyPlanner = TypeVar("AnyPlanner", bound=Table)


def asked_planners(
    own: AnyPlanner, request: Request, names: Sequence[str], with_horizon: Collection[str]
) -> list[AnyPlanner]:
    """Return the planner tables that a request asks for, each name with each horizon."""
    table = own.model_dump(include={"name", "horizon"})
    asked, horizons = request.planners or (table["name"],), request.horizons or (table["horizon"],)
    for name in asked:
        if name not in names:
            raise InputError(f"is {name!r}", key="planner.name", remedy=f"use {', '.join(names)}")
    for horizon in horizons:
        if not MIN_HORIZON <= horizon <= MAX_HORIZON:
            raise InputError(
                f"is {horizon}",
                key="planner.horizon",
                remedy=f"use {MIN_HORIZON} to {MAX_HORIZON}",
            )
    return [
        own.model_copy(update={"name": name, "horizon": horizon})
        for name in asked
        for horizon in (horizons if name in with_horizon else (1,))
    ]


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer of a system."""

    result: Any  # For Python: an object of the system's own
    data: dict[str, Any]  # The JSON object, without the problem
    words: tuple[str, ...]  # Lines for people
    exit_code: int  # 0 verified, 3 not verified, 4 no plan or not reached
    # Writes files beside the JSON file into a folder
    save: Callable[[Path], None] = lambda folder: None
    draw: Callable[[Path], None] | None = None  # Draws pictures into a folder; None for none
    failure: NoPlanError | None = None  # Why there is no result, if there is none
    step_s: Sequence[float] = ()  # Wall time of each step of a run, for comparisons

    def __repr__(self) -> str:
        """Return the words for people."""
        return "\n".join(self.words)


@dataclass(frozen=True, eq=False)
class System:
    """A kind of problems."""

    # The tables of its problem files; problem among them has name and description
    model: type[Table]
    # From validated tables and the folder that relative file names start at, to what content of a
    # problem is. Raises InputError for what the tables alone do not show.
    build: Callable[[Any, Path], Any]
    # A problem in full as JSON-serialisable tables that can be read without other files
    tables: Callable[[SystemProblem], dict[str, Any]]
    words: Callable[[SystemProblem], tuple[str, ...]]  # A problem in lines of text
    # Names of the files that answers write beside the JSON file, pictures included
    files: tuple[str, ...]
    # Judge a saved answer from its JSON file, what that says and its problem: reasons against it,
    # none if it holds
    check: Callable[[Path, Mapping[str, Any], SystemProblem], list[str]]
    # Answer a request; None for what the task has not
    solve: Callable[[SystemProblem, Request], Answer] | None = None
    simulate: Callable[[SystemProblem, Request], Answer] | None = None
    # Horizon and planner of each run that a comparison makes of a request, each once: horizons
    # count only for planners that have them. None if runs cannot be compared.
    settings: Callable[[SystemProblem, Request], Sequence[tuple[int, str]]] | None = None
    animates: bool = False  # Whether runs are drawn as an animation when that is asked for


@dataclass(frozen=True, eq=False)
class SystemProblem:
    """A problem of a system.

    Attributes
    ----------
    name, task, description
        As in its file.
    system
        Its kind.
    content
        What the system's ``build`` made.
    given
        The validated tables.
    file
        Where it came from; None if from no file.
    """

    name: str
    task: str
    description: str
    system: System = field(repr=False)
    content: Any
    given: Any = field(repr=False)
    file: Path | None

    __repr__ = short_repr

    def tables(self) -> dict[str, Any]:
        """Return the problem in full; :func:`system_from_tables` reads it."""
        return self.system.tables(self)

    def solve(
        self, *, horizon: int | None = None, planner: str | None = None, seed: int = 0
    ) -> Answer:
        """Solve the problem, as :func:`planopt.solve` solves one of motion planning.

        Parameters
        ----------
        horizon, planner
            In place of the problem's own.
        seed
            Of everything random.

        Raises
        ------
        InputError
            The task has nothing to solve, or no such setting.
        NoPlanError
            There is no solution.
        """
        return self._answered("solve", horizon, planner, seed)

    def simulate(
        self, *, horizon: int | None = None, planner: str | None = None, seed: int = 0
    ) -> Answer:
        """Simulate the problem; parameters and errors as :meth:`solve`."""
        return self._answered("simulate", horizon, planner, seed)

    def _answered(self, action: str, horizon: int | None, planner: str | None, seed: int) -> Answer:
        horizons = () if horizon is None else (horizon,)
        planners = () if planner is None else (planner,)
        answer = self.answer(action, Request(seed, horizons, planners))
        if answer.failure is not None:
            raise answer.failure
        return answer

    def answer(self, action: str, request: Request) -> Answer:
        """Return the answer to an action of :data:`ACTIONS`.

        Raises
        ------
        InputError
            The system has no such action, or the request does not fit it.
        """
        act = cast(
            "Callable[[SystemProblem, Request], Answer] | None", getattr(self.system, action)
        )
        if act is None:
            known = ", ".join(name for name in ACTIONS if getattr(self.system, name) is not None)
            raise InputError(
                f"{self.name} asks for {self.task}, which there is no {action} for",
                file=self.file,
                key="problem.task",
                remedy=f"use {known}",
            )
        return act(self, request)


def load_any(path_or_name: Path | str) -> Problem | SystemProblem:
    """Load a problem of any kind."""
    path = find_problem(path_or_name)
    found = system_from_tables(read_toml(path), folder=path.absolute().parent, file=path)
    return load_motion(path) if found is None else found


def load_system(path_or_name: Path | str) -> SystemProblem:
    """Load a problem of a system, as :func:`planopt.load` loads one of motion planning.

    Parameters
    ----------
    path_or_name
        The path of a TOML file, or the name of a library problem such as ``pursuit_design``.

    Raises
    ------
    InputError
        As :func:`planopt.load`, or the problem is one of motion planning.
    """
    found = load_any(path_or_name)
    if isinstance(found, Problem):
        raise InputError(
            f"is {found.task}, which is motion planning",
            file=found.file,
            key="problem.task",
            remedy="load it with planopt.load",
        )
    return found


def system_of(task: str | None) -> System | None:
    """Return the system of a task; None for motion planning and whatever is unknown."""
    module = None if task is None else SYSTEMS.get(task)
    return None if module is None else cast("System", import_module(module).SYSTEM)


def system_from_tables(data: object, *, folder: Path, file: Path | None) -> SystemProblem | None:
    """Return the problem in tables, validated; None if its task is no system's."""
    system = system_of(task_of_system(data))
    if system is None:
        return None
    with located(system.model, file):
        given: Any = system.model.model_validate(data)
        content = system.build(given, folder)
    named = given.problem
    return SystemProblem(named.name, named.task, named.description, system, content, given, file)


def judge_saved(file: Path, data: Mapping[str, Any]) -> list[str] | None:
    """Return reasons against a saved answer; None if its problem is no system's."""
    tables = data.get("problem_file")
    problem = system_from_tables(tables, folder=file.absolute().parent, file=file)
    return None if problem is None else problem.system.check(file, data, problem)
