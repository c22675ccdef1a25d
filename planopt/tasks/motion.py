"""Task of motion planning: robots that estimate the radio channel while they move."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planopt.errors import NoPlanError
from planopt.planning.certificate import BlockedError
from planopt.planning.files.saved import PLAN_FILE, PLAN_OR_RUN, RUN_FILE, save_no_plan
from planopt.planning.loop.results import Run, RunSummary, Solution, summary_of
from planopt.problems.load import problem_to_dict, with_overrides
from planopt.problems.planner_kinds import planner_kind
from planopt.problems.problem import Problem, problem_from_tables
from planopt.problems.schema import ProblemFile
from planopt.tasks.task import ANIMATION, NO_PLAN, Action, Task

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class MotionReport:
    """Report of a solution, a run or a missing plan for the command line."""

    problem: Problem
    words: Sequence[str]
    exit_code: int
    make_data: Callable[[], Mapping[str, Any]]
    save: Callable[[Path], None]
    figures: Callable[[], Mapping[str, Figure]]
    run: Run | None = None  # Run to animate

    files = PLAN_OR_RUN

    @property
    def data(self) -> Mapping[str, Any]:
        """Return the JSON object of the result."""
        return self.make_data()

    def draw(self, folder: Path, *, animation: bool = False) -> None:
        """Draw the figures selected by the problem, and optionally an animation."""
        from planopt.report import save_figure

        if self.problem.report.figures:
            for name, figure in self.figures().items():
                save_figure(figure, folder / name)
        if animation and self.run is not None:
            _animate(self.run, folder / ANIMATION)


def _animate(run: Run, path: Path) -> None:
    from planopt.report import save_animation

    save_animation(run, path)


def _figures(value: Solution | Run) -> Mapping[str, Figure]:
    """Return the map and, for a single robot with a goal, the belief and the time series."""
    from planopt.report import draw_belief, draw_run_series

    plan = isinstance(value, Solution)
    figures = {"plan.png" if plan else "run.png": value.plot()}
    if value.problem.task != "reach":
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
    """Common task of all motion planning problems, with result types of its own."""

    says_ahead = True

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
        """Return whether a problem enables figures."""
        return problem.report.figures

    def validated(self, problem: Problem) -> dict[str, Any]:
        """Read maps and logs, fit the channel, and return warnings."""
        from planopt.planning.initial_data import prepare
        from planopt.planning.scene import build_scenes
        from planopt.problems.plausibility import measured_warnings
        from planopt.studies.compare import default_seeds, settings_of

        if problem.compare is not None:
            settings_of([problem])
            default_seeds(problem.compare)
        prepared, warnings = prepare(problem, 0), list(self.warnings(problem))
        try:
            build_scenes(problem)
        except NoPlanError as error:
            warnings.append(str(error))
        beliefs = (prepared.belief, *prepared.belief.further)
        for belief in beliefs:
            warnings += measured_warnings(belief.posterior.measurements)
            warnings += [f"fit of the channel, seed 0: {words}" for words in belief.fit.warnings]
        count = sum(belief.fit.measurements for belief in beliefs)
        return {"measurements": count, "warnings": warnings}

    def labels(self, problem: Problem) -> tuple[int, str, str | None]:
        """Return horizon, planner and cost-to-go."""
        return problem.planner.horizon, problem.planner.name, problem.cost_to_go

    def has_horizon(self, problem: Problem) -> bool:
        """Return whether runs depend on the horizon; bounds foresee the whole run and do not."""
        return not planner_kind(problem.planner.name).foresees

    def compared_costs_to_go(self, problem: Problem) -> Sequence[str | None]:
        """Return both costs-to-go for problems with a goal."""
        return ("geodesic", "connected") if problem.task == "reach" else (None,)

    def shared(self, problem: Problem, seed: int) -> Any:
        """Return the initial data (ground truth and belief) and the geometry for goals."""
        from planopt.planning.initial_data import prepare
        from planopt.planning.scene import build_scenes

        return {"prepared": prepare(problem, seed), "scenes": build_scenes(problem)}

    def run_summary(self, problem: Problem, seed: int, shared: Any) -> RunSummary:
        """Simulate a problem and return the summary of the run."""
        from planopt.planning.loop.closed_loop import simulate

        return summary_of(simulate(problem, seed=seed, **shared))

    def words_ahead(self, problem: Problem, plans: Any) -> Iterable[str]:
        """Return text about the coverage holes on the route to each goal."""
        from planopt.report.motion_words import words_ahead

        return words_ahead(problem, plans)

    def report(self, result: Solution | Run) -> MotionReport:
        """Report a result; explain a solution that is unverified or crosses coverage holes."""
        from planopt.planning.files.result_json import run_json, solution_json
        from planopt.report.motion_words import run_in_words, solution_in_words

        figures = partial(_figures, result)
        if not isinstance(result, Solution):
            words, data = run_in_words(result), partial(run_json, result)
            code, save = result.exit_code, result.save
            return MotionReport(result.problem, words, code, data, save, figures, result)
        if result.exit_code != 0 or any(plan.holes for plan in result.plans):
            from planopt.planning.explain.explain import explain

            result = replace(result, explanation=explain(result))
        words, data = solution_in_words(result), partial(solution_json, result)
        return MotionReport(result.problem, words, result.exit_code, data, result.save, figures)

    def no_plan(
        self, action: Action, problem: Problem, seed: int, error: NoPlanError
    ) -> MotionReport:
        """Report that no plan exists; for ``solve``, suggest changes that would help."""
        from planopt.planning.explain.explain import explain_no_plan
        from planopt.planning.files.result_json import no_plan_json, no_run_json

        words, more = [f"{problem.name}: no plan: {error}"], dict[str, list[Any]]()
        figures: Callable[[], Mapping[str, Figure]] = dict
        if action == "simulate":
            name, data, more["plans"] = RUN_FILE, no_run_json(problem, seed, str(error)), []
        else:
            helpful = explain_no_plan(problem, seed)
            blocked = error.blocked if isinstance(error, BlockedError) else ()
            name, data = PLAN_FILE, no_plan_json(problem, seed, str(error), helpful, blocked)
            nothing = ["no single change of a key or obstacle gives a plan"]
            words += [f"  {each}" for each in helpful or nothing]
            figures = partial(_blocked_figures, problem, seed, error)

        def save(folder: Path) -> None:
            save_no_plan({**data, **more}, problem, folder, name)

        return MotionReport(problem, words, NO_PLAN, lambda: data, save, figures)


TASK = MotionTask(
    model=ProblemFile,
    solve="planopt.planning.solve:solve",
    simulate="planopt.planning.loop.closed_loop:simulate",
    override=with_overrides,
    controller="planopt.planning.solve:Planner",
    animate=_animate,
    steps=lambda problem: problem.planner.max_steps,
)
