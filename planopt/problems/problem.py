"""Motion planning problem as a frozen dataclass, and the cost to reach its goal.

A step of length l and duration h that starts short of the goal costs ``h + w l^2 / h``. A path of
length D beyond the horizon costs at least ``D min_v (1 + w v^2) / v`` (equation 4.16); this minimum
is the cost rate. A metre at probability of connection P counts as ``1 + price (1 - P)`` metres.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.errors import InputError, path_of
from planopt.files.writing import toml_text, write_text
from planopt.keys import located
from planopt.objectives.terms.term import Term, TermSetting, require_kind
from planopt.parts import part_of, parts_of
from planopt.problems.channel_setup import BaseStation, ChannelSetup
from planopt.problems.checks import check
from planopt.problems.objective import Constraints, CostToGo, ReachObjective, TermsObjective
from planopt.problems.robot import Robot
from planopt.problems.schema import SCHEMA_VERSION, ProblemFile, Task
from planopt.problems.settings import ComparisonSettings, PlannerSettings, ReportSettings, Target
from planopt.short_repr import wrapped
from planopt.world.workspace import Workspace

NAME = "give a name that ends in .toml"


@dataclass(frozen=True, init=False)
class Problem:
    """Complete definition of one motion planning problem.

    The constructor checks a problem as strictly as a problem file. A copy by
    :func:`dataclasses.replace` is checked when it is solved or simulated.

    Parameters
    ----------
    robots, stations
        Robots and base stations, at least one of each.
    workspace
        Bounds and obstacles.
    planner
        Duration of a step, horizon and further settings.
    objective
        :class:`planopt.objectives.ReachObjective`, or terms of :mod:`planopt.objectives` whose sum
        is maximised and the first of which determines the task. The default is to reach the
        robot's goal.
    constraints
        Constraints on every plan.
    channel
        Ground truth, initial measurements and fit. A problem without ground truth can be solved but
        not simulated. Missing initial measurements are arguments of :func:`planopt.solve`.
    targets
        Target of a tracking objective.
    name, description
        Name, used in file names, and description.
    report
        Output settings.
    compare
        Default settings of :func:`planopt.compare` for this problem, or None.
    file
        Source file, for messages; None for a problem built in Python.
    checked
        True if the problem has already been checked.

    Raises
    ------
    InputError
        A value is invalid; the error names its key in the problem file.

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
    file: Path | None = field(compare=False)
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
            # Copies by dataclasses.replace inherit the flag, which avoids repeated checks.
            "checked": True,
        }
        for key, value in parts.items():
            object.__setattr__(self, key, value)
        if not checked:
            check_problem(self)

    def __repr__(self) -> str:
        """Return a text with name, task, and the number of each kind of part."""
        return wrapped(
            f"Problem(name={self.name!r}, task={self.task!r}, robots: {len(self.robots)}, "
            f"stations: {len(self.stations)}, obstacles: {len(self.workspace.obstacles)}, "
            f"bounds_m={self.workspace.bounds_m}, horizon={self.planner.horizon}, "
            f"step_s={self.planner.step_s:g}, p_min={self.constraints.p_min:g})"
        )

    def save(self, file: Path | str) -> None:
        """Write the problem file.

        Obstacles are written as polygons; logs and maps are referred to by file name.

        Parameters
        ----------
        file
            File ending in ``.toml``; it is replaced.

        Raises
        ------
        InputError
            The problem has parts from Python, which cannot be saved.
        OutputError
            The file cannot be written.
        """
        path = path_of("file", file, NAME)
        if path.suffix != ".toml":
            raise InputError("is not a name for a problem file", file=path, remedy=NAME)
        # Reached by name: that module builds problems.
        tables = import_module("planopt.problems.load").problem_to_dict(self)
        write_text(path, toml_text(tables))

    @property
    def step_length_m(self) -> float:
        """Return the maximum step length of the first robot in metres."""
        return self.robots[0].speed_max_m_s * self.planner.step_s

    @property
    def reach(self) -> ReachObjective:
        """Return the objective of a problem of the task reach."""
        if not isinstance(self.objective, ReachObjective):
            raise AssertionError(f"the task of {self.name} is not to reach a goal")
        return self.objective

    @property
    def goal_m(self) -> tuple[float, float]:
        """Return the first robot's goal (x, y); only for the task reach."""
        goal = self.robots[0].goal_m
        if goal is None:
            raise AssertionError(f"the task of {self.name} is not to reach a goal")
        return goal

    @property
    def sense(self) -> Literal["min", "max"]:
        """Return ``min`` or ``max``, the sense of the objective."""
        return self.objective.sense

    @property
    def cost_to_go(self) -> CostToGo | None:
        """Return the form of the cost-to-go; None without a goal."""
        return self.objective.cost_to_go

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Return the terms of the objective as used in planning; empty for the task reach."""
        return tuple(term.planned(self.term_setting) for term in self.objective.terms)

    @property
    def can_be_polished(self) -> bool:
        """Return True if an NLP solver can refine plans with derivatives of all terms."""
        # The connection at the ends of probes is not smooth.
        if any(type(term).derivatives is Term.derivatives for term in self.terms):
            return False
        return self.has_dynamics or not any(term.probes_end for term in self.terms)

    @property
    def has_separation(self) -> bool:
        """Return whether the robots must keep a separation from each other."""
        return len(self.robots) > 1 and self.constraints.separation_m > 0.0

    @property
    def has_dynamics(self) -> bool:
        """Return True if any robot has dynamics other than a single integrator."""
        return not all(robot.moves_freely for robot in self.robots)

    @property
    def term_setting(self) -> TermSetting:
        """Return the properties of the problem that affect the choice and checks of terms."""
        return TermSetting(
            self.planner.horizon,
            len(self.stations),
            bool(self.targets),
            self.has_dynamics,
            not self.constraints.requires_connection and len(self.objective.terms) == 1,
            any(target.packets == "estimates" for target in self.targets),
        )

    @property
    def task(self) -> Task:
        """Return the task of the problem: reach, or the first term's task."""
        return cast("Task", self.objective.task)

    @property
    def has_goal(self) -> bool:
        """Return True if the objective is to reach a goal."""
        return self.objective.has_goal


def _objective(
    given: ReachObjective | TermsObjective | Term | Sequence[Term] | None,
) -> ReachObjective | TermsObjective:
    """Return the objective for an argument: an objective, terms, or None to reach the goal."""
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
"""Parts of a problem with tables of the same name."""


def tables_of(problem: Problem) -> dict[str, Any]:
    """Return the tables of a problem file, with the problem's parts as values."""
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
    """Raise an `InputError` for the first fault of a problem, within or across its tables."""
    with located(ProblemFile, problem.file):
        ProblemFile.model_validate(tables_of(problem))
        check(problem)


def problem_from_tables(data: object, *, folder: Path, file: Path | None) -> Problem:
    """Build a validated and checked problem from the tables of a file or from parts."""
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
    """Return `problem` with the obstacles known after `steps` steps."""
    workspace = problem.workspace
    if not workspace.timed:
        return problem
    known = workspace.known_at(steps * problem.planner.step_s)
    if known == workspace.obstacles:
        return problem
    return replace(problem, workspace=replace(workspace, obstacles=known))


def problem_of_robot(problem: Problem, number: int) -> Problem:
    """Return `problem` reduced to one robot, with that robot's weights applied to the terms."""
    robot = problem.robots[number]
    alone = replace(problem, robots=(robot,))
    if not robot.weights:
        return alone
    own = tuple(
        replace(term, weight=weight)
        for term, weight in zip(problem.terms, robot.weights, strict=True)
        if weight > 0.0
    )
    # The weights are now part of the terms.
    return replace(
        alone, robots=(replace(robot, weights=()),), objective=replace(problem.objective, terms=own)
    )


def cruising_speed_m_s(effort_weight_s2_m2: float, speed_max_m_s: float) -> float:
    """Return the speed of least cost per metre: ``1 / sqrt(w)``, at most `speed_max_m_s`."""
    if effort_weight_s2_m2 > 0.0:
        return min(speed_max_m_s, effort_weight_s2_m2**-0.5)
    return speed_max_m_s


def cost_rate_s_m(effort_weight_s2_m2: float, speed_max_m_s: float) -> float:
    """Return the least cost per metre in s/m: min over 0 < v <= v_max of (1 + w v^2) / v."""
    best = cruising_speed_m_s(effort_weight_s2_m2, speed_max_m_s)
    return (1.0 + effort_weight_s2_m2 * best**2) / best


def rate_s_m(problem: Problem) -> float:
    """Return the least cost per metre in s/m of a problem's first robot (equation 4.16)."""
    return cost_rate_s_m(problem.reach.effort_weight_s2_m2, problem.robots[0].speed_max_m_s)


def step_cost_s(length_m: Floats, step_s: float, effort_weight_s2_m2: float) -> Floats:
    """Return the cost in seconds of steps of lengths `length_m` that start short of the goal."""
    return step_s + effort_weight_s2_m2 * length_m**2 / step_s


def outage_share(probability: Floats, is_below: Mask, everywhere: bool = False) -> Floats:
    """Return the penalised share of a metre: 1 - probability where outage costs, else 0."""
    return np.where(is_below | everywhere, 1.0 - probability, 0.0)


def charged_length_m(lengths_m: Floats, share: Floats) -> float:
    """Return a path's penalised length in metres, from step lengths and penalised shares."""
    # Shapes: lengths_m (n,); share (n + 1,).
    return float(0.5 * lengths_m @ (share[:-1] + share[1:]))


PIECE_M = 1.0  # Maximum interval of the quadrature of a route's cost, in metres

GAUSS = np.polynomial.legendre.leggauss(3)


def integrated_cost_m(metre_cost: Callable[[Floats], Floats], places_m: Floats) -> float:
    """Return the integral of the cost per metre along a polyline (n, 2), by quadrature."""
    lengths = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    at, weights = 0.5 * (GAUSS[0] + 1.0), 0.5 * GAUSS[1]
    points, shares = [np.zeros((0, 2))], [np.zeros(0)]
    for (begin, end), length in zip(pairwise(places_m), lengths.tolist(), strict=True):
        if length == 0.0:
            continue
        count = math.ceil(length / PIECE_M)
        along = np.add.outer(np.arange(count, dtype=np.float64), at).ravel() / count
        points.append(begin + along[:, None] * (end - begin))
        shares.append(np.tile(weights * length / count, count))
    return float(metre_cost(np.concatenate(points)) @ np.concatenate(shares))


def path_cost_s(
    positions_m: Floats,
    goal_m: Floats,
    goal_radius_m: float,
    step_s: float,
    effort_weight_s2_m2: float,
    resting_m: Floats | None = None,
) -> float:
    """Return the cost in seconds of a path (n + 1, 2) until its end or arrival at the goal."""
    # A robot with dynamics has arrived once it can also stop at the goal. `resting_m` (n + 1, 2) is
    # its rest position after braking from each position.
    lengths = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    short_of_goal = np.linalg.norm(positions_m[:-1] - goal_m, axis=1) > goal_radius_m
    if resting_m is not None:
        short_of_goal |= np.linalg.norm(resting_m[:-1] - goal_m, axis=1) > goal_radius_m
    costs = np.where(short_of_goal, step_cost_s(lengths, step_s, effort_weight_s2_m2), 0.0)
    return float(costs.sum())


def steps_cost_s(problem: Problem, positions_m: Floats, resting_m: Floats | None = None) -> float:
    """Return the :func:`path_cost_s` of a path (n + 1, 2) of a problem's first robot."""
    radius_m, step_s = problem.constraints.goal_radius_m, problem.planner.step_s
    weight, goal = problem.reach.effort_weight_s2_m2, np.asarray(problem.goal_m)
    return path_cost_s(positions_m, goal, radius_m, step_s, weight, resting_m)


MayReach = Callable[[Floats, int, float], Mask]
"""Function that returns a mask of positions (n, 2): whether a robot may be within a distance (m) of
each after a number of steps. It is conservative: never False for a reachable position."""


def may_reach_from(problem: Problem, state: Floats) -> MayReach | None:
    """Return a function that tests reachability from `state`; None for a single integrator."""
    if problem.robots[0].moves_freely:
        return None
    dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s

    def may_reach(places_m: Floats, step: int, slack_m: float) -> Mask:
        return dynamics.may_reach(state, places_m, step * step_s, slack_m)

    return may_reach
