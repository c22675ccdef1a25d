"""State of a run's robots between steps: beliefs, tracks and plans.

The simulation or a user's own loop alternates two calls of a :class:`Stepper`:
:meth:`Stepper.plan`, and :meth:`Stepper.observe` with the outcome.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from planopt.channel.measurements import Measurements, join
from planopt.channel.posterior import Belief
from planopt.planning.initial_data import learn_measured
from planopt.planning.plan import History, Plan, Rung, history_of
from planopt.planning.reservations import has_separation
from planopt.planning.target_watch import TargetWatch, aim_of, counted
from planopt.planning.tolerances import STANDSTILL_M
from planopt.planning.values.context import Aim
from planopt.problems.problem import Problem, problem_at, problem_of_robot
from planopt.world.workspace import Obstacle


@dataclass(frozen=True, eq=False)
class TeamMoment:
    """States, beliefs, tracks and previous plans of all robots at one step."""

    beliefs: Sequence[Belief]
    states: Sequence[NDArray[np.float64]]  # (s,)
    watched: Sequence[Aim]  # External inputs of the objectives
    histories: Sequence[History]
    warm: Sequence[Plan | None]  # Previous plans
    driven_m: Sequence[NDArray[np.float64]] = ()  # (k, 2) positions after the steps so far

    @property
    def driven(self) -> int:
        """Number of steps of the run before this one."""
        return self.histories[0].steps


PlanStep = Callable[[TeamMoment], tuple[list[Plan], list[Aim]]]
"""Function from the robots' information to one plan per robot and its external inputs."""

Planning = Callable[[Problem, Sequence[NDArray[np.float64]]], PlanStep]
"""Function from the problem with currently known obstacles and all states to a planner."""


class Stepper:
    """State of the robots of one run."""

    def __init__(
        self,
        problem: Problem,
        belief: Belief,
        planning: Planning,
        watch: TargetWatch | None,
    ) -> None:
        numbers = range(len(problem.robots))
        self.states = [[robot.start_state] for robot in problem.robots]
        self._planning = planning
        self._know(problem)
        self.beliefs = [belief for _ in numbers]
        self.plans: list[list[Plan]] = [[] for _ in numbers]
        self.aims: list[list[Aim]] = [[] for _ in numbers]
        self.learnt: list[list[bool]] = [[] for _ in numbers]
        self.connected = np.zeros((0, len(numbers)), dtype=np.bool_)
        self.watches = [watch]
        self._warm: list[Plan | None] = [None for _ in numbers]

    def plan(self) -> list[Plan]:
        """Return a plan for each robot."""
        now = problem_at(self.problem, len(self.connected))
        if now is not self.problem:
            self._know(now)
        warm = self._warm
        # An error leaves no previous plan.
        self._warm = [None for _ in warm]
        moment = TeamMoment(
            beliefs=self.beliefs,
            states=[driven[-1] for driven in self.states],
            watched=[
                aim_of(self.watches[-1], number, self.problem.planner.horizon)
                for number in range(len(self.owns))
            ],
            histories=[
                history_of(
                    own,
                    np.array(driven)[:, :2],
                    self.connected[:, number],
                    [plan.certificate for plan in made],
                    gave_way=[plan.rung is Rung.GIVE_WAY for plan in made],
                )
                for number, (own, driven, made) in enumerate(
                    zip(self.owns, self.states, self.plans, strict=True)
                )
            ],
            warm=warm,
            driven_m=[np.array(driven)[1:, :2] for driven in self.states],
        )
        plans, aims = self._plan_step(moment)
        for number, (plan, aim) in enumerate(zip(plans, aims, strict=True)):
            self.plans[number].append(plan)
            self.aims[number].append(aim)
        self._warm = list(plans)
        return plans

    def _know(self, problem: Problem) -> None:
        """Replace the workspace by that of `problem`, with a new planner."""
        self._plan_step = self._planning(problem, [driven[-1] for driven in self.states])
        self.problem = problem
        self.owns = [problem_of_robot(problem, number) for number in range(len(problem.robots))]

    def add_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """Add obstacles that become known now."""
        now_s = len(self.connected) * self.problem.planner.step_s
        workspace = self.problem.workspace
        later = [replace(one, known_from_s=now_s) for one in obstacles]
        more = replace(workspace, timed=(*workspace.timed, *later))
        self.problem = replace(self.problem, workspace=more)

    def place(
        self, states: Sequence[NDArray[np.float64]], measured: Sequence[Sequence[Measurements]]
    ) -> None:
        """Set the initial states, and add measurements at the start."""
        self.beliefs = self._learnt(measured)
        self.states = [[state] for state in states]

    def observe(
        self,
        states: Sequence[NDArray[np.float64]],
        measured: Sequence[Sequence[Measurements]],
        connected: Sequence[bool] | NDArray[np.bool_],
        target_m: NDArray[np.float64] | None = None,  # (robots, 2)
    ) -> None:
        """Record the outcome of a step; an error leaves all robots unchanged."""
        beliefs = self._learnt(measured)
        links = np.vstack([self.connected, np.asarray(connected, dtype=np.bool_)])
        watch = self.watches[-1]
        if watch is not None:
            here = np.array([state[:2] for state in states])
            seen = np.full_like(here, np.nan) if target_m is None else target_m
            watch = counted(watch, seen, here, links[-1])
        for number, (state, belief) in enumerate(zip(states, beliefs, strict=True)):
            if not self._goes_on(number, state):
                self._warm[number] = None
            self.states[number].append(state)
            self.learnt[number].append(belief is not self.beliefs[number])
        self.beliefs, self.connected = beliefs, links
        self.watches.append(watch)

    def _learnt(self, measured: Sequence[Sequence[Measurements]]) -> list[Belief]:
        """Return all robots' beliefs updated with each one's measurements, by station."""
        if self.problem.channel.share_measurements:
            # A shared belief needs only one update.
            taken = [each for each in measured if each]
            everyone = [reduce(join, station) for station in zip(*taken, strict=True)]
            return [learn_measured(self.problem, self.beliefs[0], everyone)] * len(self.beliefs)
        return [
            learn_measured(self.problem, belief, taken)
            for belief, taken in zip(self.beliefs, measured, strict=True)
        ]

    def _goes_on(self, number: int, state: NDArray[np.float64]) -> bool:
        """Return whether a robot may continue its previous plan.

        Off its plan, a robot with dynamics cannot drive the remainder, and other robots do not keep
        clear of it.
        """
        plan, robot = self._warm[number], self.problem.robots[number]
        if plan is None:
            return False
        step_s = self.problem.planner.step_s
        unit = np.array(robot.dynamics.unit_m(step_s))
        if float(np.linalg.norm((state - plan.next_state) * unit)) <= STANDSTILL_M:
            return True
        return robot.moves_freely and not has_separation(self.problem)
