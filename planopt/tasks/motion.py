"""Motion planning: robots in a channel that they learn, as an entry of the registry of tasks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planopt.errors import NoPlanError
from planopt.planning.certificate import BlockedError
from planopt.planning.files.saved import PLAN_FILE, PLAN_OR_RUN, RUN_FILE, save_no_plan
from planopt.planning.results import RunSummary, Solution, summary_of
from planopt.problems.load import problem_to_dict
from planopt.problems.overrides import with_overrides
from planopt.problems.planner_kinds import planner_kind
from planopt.problems.problem import Problem, problem_from_tables
from planopt.problems.schema import ProblemFile
from planopt.tasks.task import ANIMATION, NO_PLAN, Action, Task

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from planopt.planning.results import Run


@dataclass(frozen=True, eq=False)
class MotionReport:
    """A solution or run as the command line shows, saves and draws it."""

    value: Solution | Run

    files = PLAN_OR_RUN

    @property
    def data(self) -> Mapping[str, Any]:
        """Return the JSON object."""
        from planopt.planning.files.result_json import run_json, solution_json

        value = self.value
        return solution_json(value) if isinstance(value, Solution) else run_json(value)

    @property
    def words(self) -> Sequence[str]:
        """Return lines of text."""
        from planopt.report.motion_words import run_in_words, solution_in_words

        value = self.value
        return solution_in_words(value) if isinstance(value, Solution) else run_in_words(value)

    @property
    def exit_code(self) -> int:
        """Return 0 if verified, 3 if not, 4 if there is no plan or the run did not arrive."""
        return self.value.exit_code

    def save(self, folder: Path) -> None:
        """Save the solution or run."""
        self.value.save(folder)

    def draw(self, folder: Path, *, animation: bool = False) -> None:
        """Draw the figures that the problem asks for, and an animation on request."""
        from planopt.report import save_figure

        if self.value.problem.report.figures:
            for name, figure in self._figures().items():
                save_figure(figure, folder / name)
        if animation and not isinstance(self.value, Solution):
            _animate(self.value, folder / ANIMATION)

    def _figures(self) -> Mapping[str, Figure]:
        """Return the map and, on the way to a goal, the belief and one robot's time series."""
        from planopt.report import draw_belief, draw_run_series

        value, plan = self.value, isinstance(self.value, Solution)
        figures = {"plan.png" if plan else "run.png": value.plot()}
        if value.problem.task != "reach":
            return figures
        if not isinstance(value, Solution) and len(value.runs) == 1:
            figures["series.png"] = draw_run_series(value)
        belief = value.belief if isinstance(value, Solution) else value.beliefs[0]
        return {**figures, "belief.png": draw_belief(value.problem, belief)}


@dataclass(frozen=True, eq=False)
class NoMotionReport:
    """The refusal of a problem: why there is no plan, and what would help."""

    action: Action
    problem: Problem
    seed: int
    error: NoPlanError
    data: Mapping[str, Any]
    help: Sequence[str] = ()

    files = PLAN_OR_RUN
    exit_code = NO_PLAN

    @property
    def words(self) -> Sequence[str]:
        """Return why there is no plan, and what would help."""
        return (f"{self.problem.name}: no plan: {self.error}", *(f"  {each}" for each in self.help))

    def save(self, folder: Path) -> None:
        """Save that there is no plan."""
        more: dict[str, Any] = {} if self.action == "solve" else {"plans": []}
        name = PLAN_FILE if self.action == "solve" else RUN_FILE
        save_no_plan({**self.data, **more}, self.problem, folder, name)

    def draw(self, folder: Path, *, animation: bool = False) -> None:
        """Draw the paths that a hard constraint forbids, if there are any."""
        error = self.error
        if self.action == "simulate" or not isinstance(error, BlockedError) or not error.blocked:
            return
        if self.problem.report.figures:
            from planopt.planning.initial_data import prepare
            from planopt.report import draw_no_plan, save_figure

            belief = prepare(self.problem, self.seed).belief
            figure = draw_no_plan(self.problem, belief, str(error), error.blocked)
            save_figure(figure, folder / "plan.png")


class MotionTask(Task):
    """The task of all problems of motion planning, whose results have types of their own."""

    says_ahead = True

    def problem_from(self, tables: object, *, folder: Path, file: Path | None) -> Problem:
        """Return the problem in tables, or in parts, validated."""
        return problem_from_tables(tables, folder=folder, file=file)

    def tables(self, problem: Problem) -> dict[str, Any]:
        """Return a problem in full."""
        return problem_to_dict(problem)

    def words(self, problem: Problem) -> Sequence[str]:
        """Return a problem in lines of text."""
        from planopt.report.motion_words import problem_in_words

        warnings = (f"  warning     {warning}" for warning in self.warnings(problem))
        return [*problem_in_words(problem), *warnings]

    def warnings(self, problem: Problem) -> Sequence[str]:
        """Return what is implausible in a problem."""
        from planopt.problems.plausibility import problem_warnings

        return list(problem_warnings(problem))

    def has_figures(self, problem: Problem) -> bool:
        """Return whether a problem asks for figures."""
        return problem.report.figures

    def validated(self, problem: Problem) -> dict[str, Any]:
        """Read maps and logs, fit the channel, and return what is implausible or unreachable."""
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
        """Return False for bounds, which foresee the whole run."""
        return not planner_kind(problem.planner.name).foresees

    def compared_costs_to_go(self, problem: Problem) -> Sequence[str | None]:
        """Return both costs-to-go where there is a goal."""
        return ("geodesic", "connected") if problem.task == "reach" else (None,)

    def shared(self, problem: Problem, seed: int) -> Any:
        """Return ground truth, first belief, and the geometry of robots with a goal."""
        from planopt.planning.initial_data import prepare
        from planopt.planning.scene import build_scenes

        return {"prepared": prepare(problem, seed), "scenes": build_scenes(problem)}

    def run_summary(self, problem: Problem, seed: int, shared: Any) -> RunSummary:
        """Simulate a problem and return the summary of the run."""
        from planopt.planning.loop.closed_loop import simulate

        return summary_of(simulate(problem, seed=seed, **shared))

    def words_ahead(self, problem: Problem, plans: Any) -> Iterable[str]:
        """Return the coverage holes that lie on the way to each goal."""
        from planopt.report.motion_words import words_ahead

        return words_ahead(problem, plans)

    def report(self, result: Solution | Run) -> MotionReport:
        """Explain a solution that is not verified or crosses coverage holes, and report it."""
        if isinstance(result, Solution):
            from planopt.planning.explain.explain import explain

            if result.exit_code != 0 or any(plan.holes for plan in result.plans):
                result = replace(result, explanation=explain(result))
        return MotionReport(result)

    def no_plan(
        self, action: Action, problem: Problem, seed: int, error: NoPlanError
    ) -> NoMotionReport:
        """Report a refusal; where a plan was asked for, find changes that would help."""
        from planopt.planning.explain.explain import explain_no_plan
        from planopt.planning.files.result_json import no_plan_json, no_run_json

        if action == "simulate":
            data = no_run_json(problem, seed, str(error))
            return NoMotionReport(action, problem, seed, error, data)
        helpful = explain_no_plan(problem, seed)
        blocked = error.blocked if isinstance(error, BlockedError) else ()
        data = no_plan_json(problem, seed, str(error), helpful, blocked)
        words = [str(each) for each in helpful]
        nothing = ["no change of a single key or obstacle that was tried helps"]
        return NoMotionReport(action, problem, seed, error, data, words or nothing)


def _animate(run: Run, path: Path) -> None:
    from planopt.report import save_animation

    save_animation(run, path)


TASK = MotionTask(
    model=ProblemFile,
    solve="planopt.planning.solve:solve",
    simulate="planopt.planning.loop.closed_loop:simulate",
    override=with_overrides,
    controller="planopt.planning.solve:Planner",
    animate=_animate,
    steps=lambda problem: problem.planner.max_steps,
)
