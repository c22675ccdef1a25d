"""``planopt solve`` and ``planopt simulate``: one plan or one run of a problem of any task."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from planopt.commands.options import AnimationOption, PlanningOptions, with_options
from planopt.commands.output import drawing, progress, results_folder, say, show
from planopt.errors import InputError, NoPlanError

if TYPE_CHECKING:
    from planopt.tasks.task import Action, Report, Task


@with_options(PlanningOptions)
def solve(options: PlanningOptions) -> int:
    """Plan once, from the start. Exit code 0 verified, 3 not verified, 4 no plan."""
    return _perform("solve", options)


@with_options(PlanningOptions)
def simulate(options: PlanningOptions, animation: AnimationOption = False) -> int:
    """Drive the closed loop in the ground truth. Exit code 0 verified, 3 not all, 4 not done."""
    return _perform("simulate", options, animation)


def _perform(action: Action, options: PlanningOptions, animation: bool = False) -> int:
    """Solve or simulate the problem, save, print and draw the result, and return the exit code."""
    from planopt.problems.load import load
    from planopt.problems.tasks import task_of
    from planopt.tasks.task import perform

    if animation and options.out is None:
        raise InputError(
            "an animation is saved in a folder", key="--animation", remedy="give --out"
        )
    problem = load(options.problem)
    task: Task = task_of(problem)
    if animation and task.animate is None:
        raise InputError(
            f"is not for the task {problem.task}", key="--animation", remedy="leave it out"
        )
    problem = task.overridden(
        problem, horizon=options.horizon, planner=options.planner, cost_to_go=options.cost_to_go
    )
    for words in task.warnings(problem):
        say(f"{problem.name}: {words}")

    def say_ahead(plans: Any) -> None:
        for line in task.words_ahead(problem, plans):
            say(line)

    settings: dict[str, Any] = {}
    if action == "simulate" and task.says_ahead and not options.json:
        settings["on_start"] = say_ahead
    report: Report
    total = task.steps(problem) if action == "simulate" else None
    with results_folder(options.out) as folder:
        try:
            with progress("planning" if action == "solve" else "driving, steps:", total) as advance:
                result = perform(
                    action, problem, seed=options.seed, on_step=lambda *_: advance(), **settings
                )
        except NoPlanError as error:
            # The refusal comes at once; changes that would help are solved for, which takes longer.
            refusal = f"{problem.name}: no plan: {error}"
            if not options.json:
                show(False, {}, refusal)
            with progress("explaining"):
                report = task.no_plan(action, problem, options.seed, error)
            words = [line for line in report.words if line != refusal]
        else:
            with progress("explaining"):
                report = task.report(result)
            words = [] if options.json else list(report.words)
        if folder is not None:
            report.save(folder)
        if options.json or words:
            show(options.json, report.data if options.json else {}, "\n".join(words))
        wanted = task.has_figures(problem) or animation
        with drawing(folder, report.files, wanted=wanted) as new:
            if new is not None:
                report.draw(new, animation=animation)
    return report.exit_code
