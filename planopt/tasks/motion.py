"""Task of motion planning: robots that estimate the radio channel while they move."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Any

import numpy as np

from planopt.errors import InputError, NoPlanError
from planopt.files.tables import finite
from planopt.planning.certificate import BlockedError
from planopt.planning.files.saved import PLAN_FILE, RUN_FILE, contents, signed
from planopt.planning.loop.results import Run, RunSummary, Solution, summary_of
from planopt.planning.plan import Plan, Termination, Verdict
from planopt.problems.load import problem_to_dict, with_overrides
from planopt.problems.problem import Problem, problem_from_tables
from planopt.problems.schema import ProblemFile
from planopt.problems.settings import planner_kind, planner_names
from planopt.problems.tasks import Contents, Result
from planopt.tasks.task import NO_PLAN, Action, Task, checked_again

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from planopt.planning.check.check import CheckResult
    from planopt.report.page import Page
    from planopt.studies.bench_cases import States

RUN_PLANNER, RUN_STEPS = "auto", 20
"""Planner, and number of planned steps, of closed loops in the regression suite."""


@dataclass(frozen=True, eq=False, repr=False)
class NoPlan(Result):
    """Result of an action for which no plan exists."""

    problem: Problem
    lines: Sequence[str]  # Text summary
    data: Mapping[str, Any]
    file: str  # Name of the saved file
    figures: Callable[[], Mapping[str, Figure]]

    @property
    def exit_code(self) -> int:
        """Return the exit code of the command line."""
        return NO_PLAN


def _animate(run: Solution | Run | NoPlan, path: Path) -> None:
    from planopt.report import save_animation

    if isinstance(run, Run):
        save_animation(run, path)


def _figures(value: Solution | Run | NoPlan) -> Mapping[str, Figure]:
    """Return the figures: a map and, for a robot with a goal, belief and time series."""
    from planopt.report import draw_belief, draw_run_series

    if isinstance(value, NoPlan):
        return value.figures()
    plan = isinstance(value, Solution)
    figures = {"plan.png" if plan else "run.png": value.plot()}
    if not value.problem.has_goal:
        return figures
    if not isinstance(value, Solution) and len(value.runs) == 1:
        figures["series.png"] = draw_run_series(value)
    belief = value.belief if isinstance(value, Solution) else value.beliefs[0]
    return {**figures, "belief.png": draw_belief(value.problem, belief)}


def _blocked_figures(problem: Problem, seed: int, error: NoPlanError) -> Mapping[str, Figure]:
    """Return a figure of the paths that violate a hard constraint, if there are any."""
    if not isinstance(error, BlockedError) or not error.blocked:
        return {}
    from planopt.planning.initial_data import prepare
    from planopt.report import draw_no_plan

    belief = prepare(problem, seed).belief
    return {"plan.png": draw_no_plan(problem, belief, str(error), error.blocked)}


class MotionTask(Task):
    """Task of all motion planning problems; its results are :class:`planopt.Solution` and `Run`."""

    says_ahead = True
    plans_ahead = True

    def problem_from(self, tables: object, *, folder: Path, file: Path | None) -> Problem:
        """Build a validated problem from tables or from parts."""
        return problem_from_tables(tables, folder=folder, file=file)

    def tables(self, problem: Problem) -> dict[str, Any]:
        """Return the complete tables of a problem."""
        return problem_to_dict(problem)

    def words(self, problem: Problem) -> Sequence[str]:
        """Return a text summary of a problem, line by line."""
        from planopt.report.motion_words import problem_in_words

        warnings = (f"  warning     {warning}" for warning in self.warnings(problem))
        return [*problem_in_words(problem), *warnings]

    def warnings(self, problem: Problem) -> Sequence[str]:
        """Return warnings about implausible values of a problem."""
        from planopt.problems.plausibility import problem_warnings

        return list(problem_warnings(problem))

    def has_figures(self, problem: Problem) -> bool:
        """Return True if a problem enables figures."""
        return problem.report.figures

    def validated(self, problem: Problem) -> dict[str, Any]:
        """Read maps and logs, fit the channel, and return warnings."""
        from planopt.planning.initial_data import prepare
        from planopt.planning.scene import build_scenes
        from planopt.problems.plausibility import measured_warnings
        from planopt.studies.compare import Lists, default_seeds, settings_of

        if problem.compare is not None:
            settings_of([problem], Lists())
            default_seeds(problem.compare)
        prepared, warnings = prepare(problem, 0), list(self.warnings(problem))
        try:
            build_scenes(problem)
        except NoPlanError as error:
            warnings.append(str(error))
        beliefs = (prepared.belief, *prepared.belief.further)
        for radio, belief in zip(problem.stations, beliefs, strict=True):
            warnings += measured_warnings(belief.posterior.measurements)
            warnings += [f"fit of {radio.name}, seed 0: {words}" for words in belief.fit.warnings]
        count = sum(belief.fit.measurements for belief in beliefs)
        return {"measurements": count, "warnings": warnings}

    def labels(self, problem: Problem) -> tuple[int, str, str | None]:
        """Return horizon, planner and cost-to-go."""
        return problem.planner.horizon, problem.planner.name, problem.cost_to_go

    def has_horizon(self, problem: Problem) -> bool:
        """Return True if runs depend on the horizon; performance bounds plan whole runs."""
        return not planner_kind(problem.planner.name).foresees

    def compared_costs_to_go(self, problem: Problem) -> Sequence[str | None]:
        """Return both costs-to-go for problems with a goal."""
        return ("geodesic", "connected") if problem.has_goal else (None,)

    def shared(self, problem: Problem, seed: int) -> Any:
        """Return data shared by all runs of a seed: ground truth, belief, and goal geometry."""
        from planopt.planning.initial_data import prepare
        from planopt.planning.scene import build_scenes

        return {"prepared": prepare(problem, seed), "scenes": build_scenes(problem)}

    def run_summary(self, problem: Problem, seed: int, shared: Any) -> RunSummary:
        """Simulate a problem and return the summary of the run."""
        from planopt.planning.solve import simulate

        return summary_of(simulate(problem, seed=seed, **shared))

    def planners(self, problem: Problem, kind: str) -> Sequence[str]:
        """Return the planners that solve a problem without knowing the ground truth."""
        known = planner_names() if kind == "plan" else (RUN_PLANNER,)
        return [name for name in known if _allows(problem, name)]

    def answer(
        self,
        problem: Problem,
        kind: str,
        seed: int,
        shared: Any,
        states: States = (),
        prove_s: float = 0.0,
    ) -> dict[str, Any]:
        """Return the regression-suite row for a plan, or for the first steps of a run."""
        if kind == "run":
            return _run_answer(problem, seed, shared, states)
        from planopt.planning.solve import proven, solve_on

        begun = process_time()
        solution = solve_on(problem, shared["prepared"].belief, seed, shared["scenes"])
        cpu_s = process_time() - begun
        plans, checked = solution.plans, checked_again(self, solution)
        bound = proven(solution, prove_s).bound if prove_s else None
        proofs = [plan.certificate for plan in plans]
        residuals = [proof.kkt_residual for proof in proofs if proof.kkt_residual is not None]
        return {
            **_totals(problem, plans),
            "objective": finite(sum(plan.objective for plan in plans)),
            "bound": None if bound is None else bound.value,
            "gap": None if bound is None else bound.gap,
            "verdict": solution.verdict.value,
            "termination": _worst(Termination, (plan.termination.value for plan in plans)),
            "accepted": checked.verdict is Verdict.VERIFIED,
            "reasons": checked.reasons,
            "cpu_s": cpu_s,
            "kkt_residual": max(residuals, default=None),
            "min_clearance_m": finite(min(proof.min_clearance_m for proof in proofs)),
            "min_connectivity": finite(min(proof.min_connectivity for proof in proofs)),
        }

    def words_ahead(self, problem: Problem, plans: Any) -> Iterable[str]:
        """Return text about the coverage holes on the route to each goal."""
        from planopt.report.motion_words import words_ahead

        return words_ahead(problem, plans)

    def explained(self, result: Solution | Run) -> Solution | Run:
        """Return the result, with an explanation if it is unverified or crosses coverage holes."""
        if not isinstance(result, Solution):
            return result
        if result.exit_code == 0 and not any(plan.holes for plan in result.plans):
            return result
        from planopt.planning.explain.explain import explain

        return replace(result, explanation=explain(result))

    def result_words(self, result: Solution | Run | NoPlan) -> Sequence[str]:
        """Return a text summary of a result, line by line."""
        from planopt.report.motion_words import run_in_words, solution_in_words

        if isinstance(result, NoPlan):
            return result.lines
        is_plan = isinstance(result, Solution)
        return solution_in_words(result) if is_plan else run_in_words(result)

    def contents(self, result: Solution | Run | NoPlan) -> Contents:
        """Return the contents of the files of a result; without a plan, only a JSON object."""
        if not isinstance(result, NoPlan):
            return contents(result)
        more: dict[str, Any] = {"plans": []} if result.file == RUN_FILE else {}
        return Contents(result.file, signed({**result.data, **more}))

    def main_figure(self, result: Solution | Run) -> Figure:
        """Return a figure of the result on the map; for a plan, with its predictions."""
        from planopt.report import draw_run, draw_solution

        return draw_run(result) if isinstance(result, Run) else draw_solution(result)

    def key_figures(self, result: Solution | Run) -> Iterable[tuple[str, object]]:
        """Return names and values of the key figures of a result."""
        from planopt.report.page_content import key_figures

        return key_figures(result)

    def page(self, result: Solution | Run) -> Page:
        """Return the content of the HTML page of a result."""
        from planopt.report.page_content import motion_page

        return motion_page(result)

    def data(self, result: Solution | Run) -> dict[str, Any]:
        """Return the JSON object of a result."""
        from planopt.planning.files.result_json import run_json, solution_json

        return solution_json(result) if isinstance(result, Solution) else run_json(result)

    def check(self, file: Path, data: Mapping[str, Any]) -> CheckResult:
        """Replay and verify a saved result whose JSON object is already loaded."""
        from planopt.planning.check.check import check_motion

        return check_motion(file, data)

    def load_result(self, file: Path, data: Mapping[str, Any]) -> Solution | Run:
        """Read a saved result whose JSON object is already loaded."""
        from planopt.planning.check.check import load_motion_result

        return load_motion_result(file, data)

    def no_plan(self, action: Action, problem: Problem, seed: int, error: NoPlanError) -> NoPlan:
        """Return a result without a plan; for ``solve``, list changes that would give a plan."""
        from planopt.planning.explain.explain import explain_no_plan
        from planopt.planning.files.result_json import no_plan_json, no_run_json

        words = [f"{problem.name}: no plan: {error}"]
        if action == "simulate":
            return NoPlan(problem, words, no_run_json(problem, seed, str(error)), RUN_FILE, dict)
        helpful = explain_no_plan(problem, seed)
        blocked = error.blocked if isinstance(error, BlockedError) else ()
        data = no_plan_json(problem, seed, str(error), helpful, blocked)
        nothing = ["no tested change of one key, or removal of one obstacle, gives a plan"]
        words += [f"  {each}" for each in helpful or nothing]
        figures = partial(_blocked_figures, problem, seed, error)
        return NoPlan(problem, words, data, PLAN_FILE, figures)


def _allows(problem: Problem, planner: str) -> bool:
    """Return True if a planner can solve a problem without knowing the ground truth."""
    kind = planner_kind(planner)
    if kind.foresees or (kind.tracks and not problem.targets):
        return False
    try:
        with_overrides(problem, planner=planner)
    except InputError:
        return False
    return kind.has_dynamics or not problem.has_dynamics


def _run_answer(problem: Problem, seed: int, shared: Any, recorded: States) -> dict[str, Any]:
    """Return the regression suite's row for a run's first steps, from `recorded` states if any."""
    from planopt.planning.free_space import with_drawn_starts
    from planopt.planning.initial_data import team_seeds
    from planopt.planning.loop.drive import first_steps, true_world
    from planopt.planning.stepping import watch_target
    from planopt.planning.team.team_step import planning

    begun = process_time()
    problem = with_drawn_starts(problem, seed)
    seeds = team_seeds(problem, seed)
    prepared, scenes = shared["prepared"], shared["scenes"] if problem.has_goal else None
    steps, states = first_steps(
        problem,
        prepared.belief,
        true_world(problem, prepared.truths, list),
        planning(problem, scenes, seeds),
        watch_target(problem, seeds.target),
        seeds.target,
        RUN_STEPS,
        recorded,
    )
    cpu_s = process_time() - begun
    plans = [plan for each in steps for plan in each]
    found = (plan.objective for plan in plans)
    return {
        **_totals(problem, plans),
        "objective": finite(sum(found) / len(plans)) if plans else None,
        "verdict": _worst(Verdict, (plan.verdict.value for plan in plans)),
        "cpu_s": cpu_s,
        "states": recorded or tuple(tuple(tuple(s.tolist()) for s in each) for each in states),
    }


def _totals(problem: Problem, plans: Sequence[Plan]) -> dict[str, Any]:
    """Return totals over all plans for a row of the regression suite, with a hash of the paths."""
    deadline_s = problem.planner.budget_s or problem.planner.step_s
    # Adding zero turns negative zeros into positive ones.
    paths = (np.round(plan.positions_m, 3) + 0.0 for plan in plans)
    rounded = b"".join(path_m.astype("<f8").tobytes() for path_m in paths)
    return {
        "outcome": "planned",
        "rungs": dict(Counter(plan.rung.value for plan in plans)),
        "iterations": sum(plan.iterations for plan in plans),
        "solve_s": float(sum(plan.solve_s for plan in plans)),
        "wall_s": float(sum(plan.wall_s for plan in plans)),
        "steps": len(plans),
        "late": sum(plan.wall_s > deadline_s for plan in plans),
        "path_digest": hashlib.sha256(rounded).hexdigest()[:16],
    }


def _worst(labels: type[Verdict] | type[Termination], named: Iterable[str]) -> str:
    """Return the worst of the named labels; the enumeration orders them from good to bad."""
    order = [label.value for label in labels]
    return max(named, key=order.index, default=order[-1])


TASK = MotionTask(
    model=ProblemFile,
    solve="planopt.planning.solve:solve",
    simulate="planopt.planning.solve:simulate",
    override=with_overrides,
    controller="planopt.planning.solve:Planner",
    figures=_figures,
    animate=_animate,
    steps=lambda problem: problem.planner.max_steps,
)
