"""A planning problem as plain frozen data, units in the names. No file, no solver, no truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast

from planopt.problems.channel_setup import ChannelSetup
from planopt.problems.constraints import Constraints
from planopt.problems.objective import CostToGo, ReachObjective, Term, TermsObjective
from planopt.problems.radio_station import RadioStation
from planopt.problems.robot import Robot
from planopt.problems.settings import PlannerSettings, ReportSettings
from planopt.problems.target import Target
from planopt.short_repr import wrapped
from planopt.world.workspace import Workspace

Task = Literal["reach", "track", "learn", "map", "connect", "custom"]


@dataclass(frozen=True)
class Problem:
    """Everything that defines one planning problem.

    Attributes
    ----------
    name, description
        For people.
    workspace
        Bounds and obstacles.
    channel, robots, stations, objective, constraints, planner
        The tables of the problem file.
    file
        Where it was read from, for messages; None if made in Python.
    report, targets
        The tables of these names.
    """

    name: str
    description: str
    workspace: Workspace
    channel: ChannelSetup
    robots: tuple[Robot, ...]
    stations: tuple[RadioStation, ...]
    objective: ReachObjective | TermsObjective
    constraints: Constraints
    planner: PlannerSettings
    file: Path | None = None
    report: ReportSettings = field(default_factory=ReportSettings)
    targets: tuple[Target, ...] = ()

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
        """Longest way of the (first) robot in one step."""
        return self.robots[0].speed_max_m_s * self.planner.step_s

    @property
    def reach(self) -> ReachObjective:
        """The objective of a problem that is to reach a goal; others have none."""
        if not isinstance(self.objective, ReachObjective):
            raise AssertionError(f"the task of {self.name} is not to reach a goal")
        return self.objective

    @property
    def goal_m(self) -> tuple[float, float]:
        """Where the (first) robot must go; only in a problem that is to reach a goal."""
        goal = self.robots[0].goal_m
        if goal is None:
            raise AssertionError(f"the task of {self.name} is not to reach a goal")
        return goal

    @property
    def sense(self) -> Literal["min", "max"]:
        """Whether less or more of the objective is better."""
        return "min" if isinstance(self.objective, ReachObjective) else "max"

    @property
    def cost_to_go(self) -> CostToGo | None:
        """What the way beyond the horizon costs; None where there is no goal."""
        return self.objective.cost_to_go if isinstance(self.objective, ReachObjective) else None

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of the objective; none where the task is to reach a goal."""
        return self.objective.terms if isinstance(self.objective, TermsObjective) else ()

    @property
    def task(self) -> Task:
        """What the problem asks: its goal, or its first term."""
        if isinstance(self.objective, ReachObjective):
            return "reach"
        return cast("Task", self.objective.terms[0].task or "custom")
