"""The cases of the regression suite: problems with seeds, horizons, planners and settings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

from planopt.errors import InputError
from planopt.problems.library import list_problems
from planopt.problems.load import load_motion
from planopt.problems.overrides import with_overrides
from planopt.problems.planner_kinds import planner_kind, planner_names
from planopt.problems.problem import Problem
from planopt.problems.tasks import MOTION

PLAN, RUN = "plan", "run"
"""Kinds of cases: one plan from the start, or the first steps of a closed loop."""

States = tuple[tuple[tuple[float, ...], ...], ...]
"""States by step and robot."""

HORIZONS = (5, 20)
"""Steps ahead that every problem is solved with, besides its own."""

RUN_PLANNER = "auto"
"""Planner of closed-loop cases, which take longer than a single plan."""

COSTS_TO_GO = ("connected", "geodesic")
"""Settings of problems with a goal."""


@dataclass(frozen=True, order=True)
class Question:
    """A question to planners, whose answers are compared with each other."""

    problem: str  # Name in the library, or path of a problem file
    kind: str  # plan or run
    cost_to_go: str  # Empty where there is no goal
    horizon: int  # Steps ahead
    seed: int  # Of everything drawn

    def __str__(self) -> str:
        """Return the question in words."""
        cost = f"{self.cost_to_go} cost-to-go, " if self.cost_to_go else ""
        return f"{self.problem}, {self.kind}, {cost}horizon {self.horizon}, seed {self.seed}"


@dataclass(frozen=True, order=True)
class Case:
    """A question and the planner that answers it."""

    question: Question
    planner: str
    # Of a closed loop: the states that its robots are moved to; empty if they follow their plans
    states: States = field(default=(), compare=False)

    def __str__(self) -> str:
        """Return the case in words."""
        return f"{self.question}, planner {self.planner}"


def library_cases(
    problems: Sequence[str] | None = None,
    *,
    planners: Sequence[str] | None = None,
    horizons: Sequence[int] | None = None,
    seeds: Iterable[int] = range(3),
    run_seeds: Iterable[int] = range(1),
) -> list[Case]:
    """Return every combination that the problems allow, problem by problem and seed by seed."""
    known = planner_names()
    for name in planners or ():
        if name not in known:
            raise InputError(
                f"no planner is called {name!r}",
                key="planners",
                remedy=f"one of {', '.join(known)}",
            )
    names = library_names() if problems is None else problems
    each, driven = list(seeds), list(run_seeds)
    cases: list[Case] = []
    for name in dict.fromkeys(names):
        problem = load_motion(name)
        own = problem.planner.horizon
        ahead = sorted({own, *HORIZONS}) if horizons is None else list(dict.fromkeys(horizons))
        for horizon in ahead:
            with_overrides(problem, horizon=horizon)
        allowed = [one for one in planners or known if _allows(problem, one)]
        costs = COSTS_TO_GO if problem.task == "reach" else ("",)
        for seed in sorted({*each, *driven}):
            if seed in each:
                cases += [
                    Case(Question(name, PLAN, cost, horizon, seed), planner)
                    for cost in costs
                    for horizon in ahead
                    for planner in allowed
                ]
            if seed in driven and RUN_PLANNER in allowed:
                question = Question(name, RUN, problem.cost_to_go or "", own, seed)
                cases.append(Case(question, RUN_PLANNER))
    if not cases:
        raise InputError(
            "there is no case: no problem allows one of the planners",
            key="planners",
            remedy="name another planner or another problem",
        )
    return cases


def library_names() -> list[str]:
    """Return the library problems of motion planning, which planners answer."""
    return [entry.name for entry in list_problems() if entry.task in MOTION]


def problem_of(case: Case) -> Problem:
    """Load the problem of a case, with its settings."""
    question = case.question
    asked = with_overrides(
        load_motion(question.problem),
        horizon=question.horizon,
        planner=case.planner,
        cost_to_go=question.cost_to_go or None,
    )
    return replace(asked, report=replace(asked.report, figures=False))


def _allows(problem: Problem, planner: str) -> bool:
    """Return whether a planner can plan for a problem, without knowing the ground truth."""
    kind = planner_kind(planner)
    if kind.foresees or (kind.tracks and not problem.targets):
        return False
    try:
        with_overrides(problem, planner=planner)
    except InputError:
        return False
    single = all(robot.dynamics is None for robot in problem.robots)
    return single or kind.has_dynamics
