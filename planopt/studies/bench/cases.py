"""Cases of the regression suite, and their result rows, each verified from its files."""

from __future__ import annotations

import hashlib
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import one_blas_thread
from planopt.errors import InputError, NoPlanError
from planopt.files.typed_json import encoded, finite
from planopt.planning.check.check import check_motion
from planopt.planning.files.saved import read_object
from planopt.planning.initial_data import Prepared, prepare, team_seeds, with_drawn_starts
from planopt.planning.loop.drive import first_steps, true_world
from planopt.planning.plan import Plan, Rung, Termination, Verdict
from planopt.planning.scene import Scene, build_scenes
from planopt.planning.solve import solve_on
from planopt.planning.target_watch import watch_target
from planopt.planning.team.couriers import planning
from planopt.problems.library import list_problems
from planopt.problems.load import load_motion, with_overrides
from planopt.problems.planner_kinds import planner_kind, planner_names
from planopt.problems.problem import Problem
from planopt.problems.tasks import MOTION
from planopt.studies.study import run_key

PLAN, RUN = "plan", "run"
"""Kinds of cases: one plan from the start, or the first steps of a closed loop."""

States = tuple[tuple[tuple[float, ...], ...], ...]
"""States, by step and robot."""

HORIZONS = (5, 20)
"""Horizons in steps that every problem is solved with, in addition to its own."""

RUN_PLANNER = "auto"
"""Planner of closed-loop cases, which take longer than a single plan."""

COSTS_TO_GO = ("connected", "geodesic")
"""Cost-to-go settings of problems with a goal."""

PLANNED, NO_PLAN, ERROR = "planned", "no_plan", "error"
"""Outcomes of cases."""

RUN_STEPS = 20
"""Number of planned steps of a closed loop."""


@dataclass(frozen=True, order=True)
class Question:
    """A planning task that several planners solve, so that their answers can be compared."""

    problem: str  # Name in the library, or path of a problem file
    kind: str  # plan or run
    cost_to_go: str  # Empty if there is no goal
    horizon: int  # Planning horizon in steps
    seed: int  # Random seed

    def __str__(self) -> str:
        """Return the question as text."""
        cost = f"{self.cost_to_go} cost-to-go, " if self.cost_to_go else ""
        return f"{self.problem}, {self.kind}, {cost}horizon {self.horizon}, seed {self.seed}"


@dataclass(frozen=True, order=True)
class Case:
    """A question and the planner that answers it."""

    question: Question
    planner: str
    # States imposed on the robots of a closed loop; empty if they follow their plans
    states: States = field(default=(), compare=False)

    def __str__(self) -> str:
        """Return the case as text."""
        return f"{self.question}, planner {self.planner}"


def library_cases(
    problems: Sequence[str] | None = None,
    *,
    planners: Sequence[str] | None = None,
    horizons: Sequence[int] | None = None,
    seeds: Iterable[int] = range(3),
    run_seeds: Iterable[int] = range(1),
) -> list[Case]:
    """Return every valid combination, ordered by problem and then by seed."""
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
    """Return the names of the motion planning problems in the library."""
    return [entry.name for entry in list_problems() if entry.task in MOTION]


def problem_of(case: Case) -> Problem:
    """Load the problem of a case and apply its settings."""
    question = case.question
    asked = with_overrides(
        load_motion(question.problem),
        horizon=question.horizon,
        planner=case.planner,
        cost_to_go=question.cost_to_go or None,
    )
    return replace(asked, report=replace(asked.report, figures=False))


def _allows(problem: Problem, planner: str) -> bool:
    """Return whether a planner can solve a problem without knowing the ground truth."""
    kind = planner_kind(planner)
    if kind.foresees or (kind.tracks and not problem.targets):
        return False
    try:
        with_overrides(problem, planner=planner)
    except InputError:
        return False
    return kind.has_dynamics or not problem.has_dynamics


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Result of a case in rows and references; with several robots, the sum or the worst."""

    problem: str
    kind: str
    cost_to_go: str
    horizon: int
    seed: int
    planner: str
    sense: str  # max or min: whether the objective is maximised or minimised
    # Objective of a plan, or the mean over the plans of a run
    objective: float | None = None
    verdict: str = Verdict.NONE.value  # Verdict reported by the planner; for a run the worst
    outcome: str = ""  # planned, no_plan or error
    rungs: dict[str, int] = field(default_factory=dict[str, int])  # Number of steps by fallback
    # CPU time of the case, excluding channel simulation, channel fit and scene construction
    cpu_s: float = 0.0
    # States of the robots of a run after each step; the check plans from the same states, so that
    # rounding differences between processors do not accumulate
    states: States = ()

    @property
    def question(self) -> Question:
        """Return the question of the case."""
        return Question(self.problem, self.kind, self.cost_to_go, self.horizon, self.seed)

    @property
    def case(self) -> Case:
        """Return the case."""
        return Case(self.question, self.planner, self.states)


@dataclass(frozen=True, kw_only=True)
class Row(Answer):
    """Result row of one case."""

    termination: str = ""
    # Whether planopt check accepts the saved files; None if nothing was saved
    accepted: bool | None = None
    reasons: tuple[str, ...] = ()  # Objections of the check, or the error
    iterations: int = 0  # Solver iterations
    solve_s: float = 0.0
    wall_s: float = 0.0
    steps: int = 0  # Number of plans, one per step and robot
    path_digest: str = ""  # Digest of all positions, rounded to 1 mm
    kkt_residual: float | None = None  # From the certificate; None for a run
    min_clearance_m: float | None = None
    min_connectivity: float | None = None


@dataclass(frozen=True)
class Start:
    """Initial belief and scenes that all cases of one problem and seed have in common."""

    prepared: Prepared
    scenes: tuple[Scene, ...] | None
    no_plan: str = ""


def start_of(case: Case) -> Start:
    """Draw the channel, fit it and build the scenes for the cases of one problem and seed."""
    problem = problem_of(case)
    prepared = prepare(problem, case.question.seed)
    try:
        return Start(prepared, build_scenes(problem))
    except NoPlanError as error:
        return Start(prepared, None, str(error))


def key_of(case: Case) -> dict[str, Any]:
    """Return everything that determines a row."""
    return {
        **run_key(problem_of(case), case.question.seed),
        "planner_version": planner_kind(case.planner).version,
        "kind": case.question.kind,
        "name": case.question.problem,
        "states": encoded(case.states),
    }


@one_blas_thread()
def answer(case: Case, start: Start) -> Row:
    """Solve a case and check the result from its files; every error becomes a row."""
    problem = problem_of(case)
    nothing = _nothing(case, problem)
    if start.no_plan:
        return replace(nothing, outcome=NO_PLAN, reasons=(start.no_plan,))
    begun = process_time()
    try:
        if case.question.kind == RUN:
            return _run_row(problem, nothing, start, case.states)
        return _plan_row(problem, nothing, start)
    except NoPlanError as error:
        outcome, words = NO_PLAN, str(error)
    except Exception as error:
        outcome, words = ERROR, f"{type(error).__name__}: {error}"
    return replace(nothing, outcome=outcome, reasons=(words,), cpu_s=process_time() - begun)


def _nothing(case: Case, problem: Problem) -> Row:
    """Return the row of a case without a result."""
    no_path = "" if case.question.kind == RUN else Termination.NO_PATH.value
    question = asdict(case.question)
    return Row(**question, planner=case.planner, sense=problem.sense, termination=no_path)


def _plan_row(problem: Problem, nothing: Row, start: Start) -> Row:
    begun = process_time()
    solution = solve_on(problem, start.prepared.belief, nothing.seed, start.scenes)
    cpu_s = process_time() - begun
    plans = solution.plans
    with tempfile.TemporaryDirectory() as folder:
        solution.save(Path(folder))
        checked = check_motion(*read_object(Path(folder)))
    proofs = [plan.certificate for plan in plans]
    residuals = [proof.kkt_residual for proof in proofs if proof.kkt_residual is not None]
    return replace(
        nothing,
        **_totals(plans),
        objective=finite(sum(plan.objective for plan in plans)),
        verdict=solution.verdict.value,
        termination=_worst(Termination, (plan.termination.value for plan in plans)),
        outcome=PLANNED,
        accepted=checked.verdict is Verdict.VERIFIED,
        reasons=checked.reasons,
        cpu_s=cpu_s,
        path_digest=_digest(plan.positions_m for plan in plans),
        kkt_residual=max(residuals, default=None),
        min_clearance_m=finite(min(proof.min_clearance_m for proof in proofs)),
        min_connectivity=finite(min(proof.min_connectivity for proof in proofs)),
    )


def _run_row(problem: Problem, nothing: Row, start: Start, recorded: States) -> Row:
    begun = process_time()
    problem = with_drawn_starts(problem, nothing.seed)
    seeds = team_seeds(problem, nothing.seed)
    scenes = start.scenes if problem.task == "reach" else None
    steps, states = first_steps(
        problem,
        start.prepared.belief,
        true_world(problem, start.prepared.truths, list),
        planning(problem, scenes, seeds),
        watch_target(problem, seeds.target),
        seeds.target,
        RUN_STEPS,
        recorded,
    )
    cpu_s = process_time() - begun
    plans = [plan for each in steps for plan in each]
    found = (plan.objective for plan in plans)
    return replace(
        nothing,
        **_totals(plans),
        objective=finite(sum(found) / len(plans)) if plans else None,
        verdict=_worst(Verdict, (plan.verdict.value for plan in plans)),
        outcome=PLANNED,
        cpu_s=cpu_s,
        path_digest=_digest(plan.positions_m for plan in plans),
        states=recorded or tuple(tuple(tuple(s.tolist()) for s in each) for each in states),
    )


def _totals(plans: Sequence[Plan]) -> dict[str, Any]:
    """Return the entries of a row that are totals over plans."""
    return {
        "rungs": dict(Counter(plan.rung.value for plan in plans)),
        "iterations": sum(plan.iterations for plan in plans),
        "solve_s": float(sum(plan.solve_s for plan in plans)),
        "wall_s": float(sum(plan.wall_s for plan in plans)),
        "steps": len(plans),
    }


def _worst(labels: type[Verdict] | type[Termination] | type[Rung], named: Iterable[str]) -> str:
    """Return the worst label; the members of each type are ordered from good to bad."""
    order = [label.value for label in labels]
    return max(named, key=order.index, default=order[-1])


def _digest(paths_m: Iterable[NDArray[np.float64]]) -> str:
    """Return a digest of paths, rounded to 1 mm."""
    # Adding zero turns negative zeros into positive ones.
    rounded = b"".join((np.round(path_m, 3) + 0.0).astype("<f8").tobytes() for path_m in paths_m)
    return hashlib.sha256(rounded).hexdigest()[:16]
