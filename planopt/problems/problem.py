"""A planning problem as plain frozen data, units in the names. No file, no solver, no truth.

Its objective has two forms: reach a goal, or a weighted sum of terms. Also the problem at one time
of a run, and that of one robot.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, cast

from planopt.keys import located
from planopt.objectives.terms.term import Term, TermSetting, require_kind
from planopt.parts import part_of, parts_of
from planopt.problems.channel_setup import BaseStation, ChannelSetup
from planopt.problems.checks import check
from planopt.problems.constraints import Constraints
from planopt.problems.objective import CostToGo, ReachObjective, TermsObjective
from planopt.problems.robot import Robot
from planopt.problems.schema import SCHEMA_VERSION, ProblemFile, Task
from planopt.problems.settings import ComparisonSettings, PlannerSettings, ReportSettings, Target
from planopt.short_repr import wrapped
from planopt.world.workspace import Workspace


@dataclass(frozen=True, init=False)
class Problem:
    """Everything that defines one planning problem.

    A problem is checked when it is made, as strictly as a problem file. One that
    :func:`dataclasses.replace` makes of it is checked when it is solved or simulated.

    Parameters
    ----------
    robots, stations
        At least one of each.
    workspace
        Bounds and obstacles.
    planner
        Duration of a step, horizon and further settings.
    objective
        A :class:`planopt.objectives.ReachObjective`, or terms of :mod:`planopt.objectives` to be
        maximised, of which the first says what the task is. By default the goal of the robot is to
        be reached.
    constraints
        What every plan must keep.
    channel
        Ground truth, first measurements and fit. Without ground truth a problem can be solved, not
        simulated; without first measurements they are given to :func:`planopt.solve`.
    targets
        The target, where an objective tracks one.
    name, description
        For people and file names.
    report
        What is drawn.
    compare
        What :func:`planopt.compare` runs where it is given no settings; None if the problem has
        none of its own.
    file
        Where it was read from, for messages; None if made in Python.
    checked
        Whether it has been checked already.

    Raises
    ------
    InputError
        Something is not allowed; the error names the key of the problem file.

    Examples
    --------
    >>> import planopt
    >>> problem = planopt.Problem(
    ...     robots=planopt.Robot(start_m=(5, 5), goal_m=(35, 25), speed_max_m_s=2.0),
    ...     stations=planopt.BaseStation(
    ...         position_m=(20, 15), transmit_power_dbm=10.0, threshold_dbm=-70.0
    ...     ),
    ...     workspace=planopt.Workspace((0, 0, 40, 30)),
    ...     constraints=planopt.Constraints(p_min=0.9),
    ...     planner=planopt.PlannerSettings(step_s=1.0),
    ... )
    >>> problem.task
    'reach'
    """

    name: str
    description: str
    workspace: Workspace
    channel: ChannelSetup
    robots: tuple[Robot, ...]
    stations: tuple[BaseStation, ...]
    objective: ReachObjective | TermsObjective
    constraints: Constraints
    planner: PlannerSettings
    file: Path | None
    report: ReportSettings
    targets: tuple[Target, ...]
    compare: ComparisonSettings | None
    checked: bool = field(repr=False, compare=False)

    def __init__(
        self,
        *,
        robots: Robot | Iterable[Robot],
        stations: BaseStation | Iterable[BaseStation],
        workspace: Workspace,
        planner: PlannerSettings,
        objective: ReachObjective | TermsObjective | Term | Sequence[Term] | None = None,
        constraints: Constraints | None = None,
        channel: ChannelSetup | None = None,
        targets: Target | Iterable[Target] = (),
        name: str = "problem",
        description: str = "",
        report: ReportSettings | None = None,
        compare: ComparisonSettings | None = None,
        file: Path | None = None,
        checked: bool = False,
    ) -> None:
        parts: dict[str, Any] = {
            "name": name,
            "description": description,
            "workspace": part_of("world", workspace, Workspace),
            "channel": part_of("channel", channel or ChannelSetup(), ChannelSetup),
            "robots": parts_of("robots", robots, Robot),
            "stations": parts_of("stations", stations, BaseStation),
            "objective": _objective(objective),
            "constraints": part_of("constraints", constraints or Constraints(), Constraints),
            "planner": part_of("planner", planner, PlannerSettings),
            "file": file,
            "report": part_of("report", report or ReportSettings(), ReportSettings),
            "targets": parts_of("targets", targets, Target),
            "compare": None if compare is None else part_of("compare", compare, ComparisonSettings),
            # Copies by dataclasses.replace take it over: they are not checked again and again.
            "checked": True,
        }
        for key, value in parts.items():
            object.__setattr__(self, key, value)
        if not checked:
            check_problem(self)

    def __repr__(self) -> str:
        """Return the name, the task, and how many of everything there are."""
        return wrapped(
            f"Problem(name={self.name!r}, task={self.task!r}, robots: {len(self.robots)}, "
            f"stations: {len(self.stations)}, obstacles: {len(self.workspace.obstacles)}, "
            f"bounds_m={self.workspace.bounds_m}, horizon={self.planner.horizon}, "
            f"step_s={self.planner.step_s:g}, p_min={self.constraints.p_min:g})"
        )

    @property
    def step_length_m(self) -> float:
        """Return the longest step of the (first) robot."""
        return self.robots[0].speed_max_m_s * self.planner.step_s

    @property
    def reach(self) -> ReachObjective:
        """Return the objective of a problem that is to reach a goal."""
        if not isinstance(self.objective, ReachObjective):
            raise AssertionError(f"the task of {self.name} is not to reach a goal")
        return self.objective

    @property
    def goal_m(self) -> tuple[float, float]:
        """Return the (first) robot's goal; only in a problem that is to reach a goal."""
        goal = self.robots[0].goal_m
        if goal is None:
            raise AssertionError(f"the task of {self.name} is not to reach a goal")
        return goal

    @property
    def sense(self) -> Literal["min", "max"]:
        """Return whether less or more of the objective is better."""
        return "min" if isinstance(self.objective, ReachObjective) else "max"

    @property
    def cost_to_go(self) -> CostToGo | None:
        """Return the form of the cost-to-go; None where there is no goal."""
        return self.objective.cost_to_go if isinstance(self.objective, ReachObjective) else None

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Return the terms of the objective as plans use them; none for the task reach."""
        if isinstance(self.objective, ReachObjective):
            return ()
        return tuple(term.planned(self.term_setting) for term in self.objective.terms)

    @property
    def can_be_polished(self) -> bool:
        """Return whether a solver improves plans by the derivatives of all terms.

        Tries are searched only, because the connection at their ends is not smooth; drives of
        robots with dynamics are refined all the same.
        """
        if any(type(term).derivatives is Term.derivatives for term in self.terms):
            return False
        return self.has_dynamics or not any(term.probes_end for term in self.terms)

    @property
    def has_dynamics(self) -> bool:
        """Return whether a robot has dynamics other than the single integrator."""
        return not all(robot.moves_freely for robot in self.robots)

    @property
    def term_setting(self) -> TermSetting:
        """Return the parts that decide how terms are planned for."""
        objective = self.objective
        has_one = isinstance(objective, TermsObjective) and len(objective.terms) == 1
        return TermSetting(
            self.planner.horizon,
            len(self.stations),
            bool(self.targets),
            self.has_dynamics,
            not self.constraints.asks_connection and has_one,
            any(target.packets == "estimates" for target in self.targets),
        )

    @property
    def task(self) -> Task:
        """Return the task of the problem: that of its goal, or of its first term."""
        if isinstance(self.objective, ReachObjective):
            return "reach"
        return cast("Task", self.objective.terms[0].task or "custom")


def _objective(
    given: ReachObjective | TermsObjective | Term | Sequence[Term] | None,
) -> ReachObjective | TermsObjective:
    """Return the objective that is given, as terms or by default a goal."""
    if given is None:
        return ReachObjective()
    if isinstance(given, ReachObjective):
        return given
    terms = given.terms if isinstance(given, TermsObjective) else given
    remedy = "give terms of planopt.objectives, or of a class that derives from OwnTerm"
    found = parts_of("objective.terms", terms, Term, remedy)
    for number, term in enumerate(found):
        require_kind(term, f"objective.terms[{number}]")
    return TermsObjective(found)


PARTS = (
    *("channel", "robots", "stations", "targets", "objective", "constraints", "planner"),
    *("report", "compare"),
)
"""Parts of a problem that are tables of the same name."""


def tables_of(problem: Problem) -> dict[str, Any]:
    """Return the tables of a problem, as the parts that it is made of."""
    tables: dict[str, Any] = {
        "problem": {
            "schema": SCHEMA_VERSION,
            "name": problem.name,
            "task": problem.task,
            "description": problem.description,
        },
        "world": problem.workspace,
    }
    tables |= {key: getattr(problem, key) for key in PARTS}
    return {key: value for key, value in tables.items() if value is not None}


def check_problem(problem: Problem) -> None:
    """Raise the first fault of a problem: of its tables, or of several of them together."""
    with located(ProblemFile, problem.file):
        ProblemFile.model_validate(tables_of(problem))
        check(problem)


def problem_from_tables(data: object, *, folder: Path, file: Path | None) -> Problem:
    """Return the problem in the tables of a file, or in parts, validated and checked."""
    with located(ProblemFile, file):
        tables = ProblemFile.model_validate(data, context={"folder": folder})
        problem = Problem(
            name=tables.problem.name,
            description=tables.problem.description,
            workspace=tables.world,
            file=file,
            checked=True,
            **{key: getattr(tables, key) for key in PARTS},
        )
        check(problem)
    return problem


def problem_at(problem: Problem, steps: int) -> Problem:
    """Return `problem` with the obstacles that are known after so many steps.

    The problem itself where these are its obstacles.
    """
    workspace = problem.workspace
    if not workspace.timed:
        return problem
    known = workspace.known_at(steps * problem.planner.step_s)
    if known == workspace.obstacles:
        return problem
    return replace(problem, workspace=replace(workspace, obstacles=known))


def problem_of_robot(problem: Problem, number: int) -> Problem:
    """Return `problem` with one robot alone, and the terms by its weights."""
    robot = problem.robots[number]
    alone = replace(problem, robots=(robot,))
    if not robot.weights:
        return alone
    own = tuple(
        replace(term, weight=weight)
        for term, weight in zip(problem.terms, robot.weights, strict=True)
        if weight > 0.0
    )
    # Its weights are those of its terms now.
    return replace(
        alone, robots=(replace(robot, weights=()),), objective=replace(problem.objective, terms=own)
    )
