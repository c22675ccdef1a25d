"""The options that planning commands share, and problems of a system."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from planopt.commands.options import AnimationOption, Own, PlanningOptions, with_options
from planopt.commands.output import drawing, progress, results_folder, say, show
from planopt.errors import InputError

if TYPE_CHECKING:
    from planopt.files.result_folder import Patterns
    from planopt.problems.problem import Problem
    from planopt.problems.systems import Request, SystemProblem


def answer_command(
    problem: SystemProblem,
    action: str,
    request: Request,
    *,
    out: Path | None,
    json: bool,
    replaced: Patterns,
    file: str,
    not_for_it: dict[str, str | None],
) -> int:
    """Do what a command asks, and return the exit code."""
    from dataclasses import replace

    from planopt.files.result_folder import replaced_results
    from planopt.files.whole import strict_text, write_text

    for option, value in not_for_it.items():
        if value is not None:
            raise InputError(
                f"is not for the task {problem.task}", key=option, remedy="leave it out"
            )
    files = (*replaced, *problem.system.files)
    with results_folder(out) as folder:
        with progress(f"{action}, steps:") as advance:
            answer = problem.answer(action, replace(request, on_step=advance))
        if folder is not None:
            with replaced_results(folder, files) as new:
                answer.save(new)
                record = {**answer.data, "problem_file": problem.tables()}
                write_text(new / file, strict_text(record))
        show(json, answer.data, "\n".join(answer.words))
        with drawing(folder, files, wanted=answer.draw is not None) as new:
            if new is not None and answer.draw is not None:
                answer.draw(new)
    return answer.exit_code


@dataclass(frozen=True)
class Asked:
    """The options that were given on the command line."""

    problem: Problem  # With the overrides of the command line
    seed: int  # The options of these names
    out: Path | None
    json: bool
    animation: bool = False

    @property
    def has_pictures(self) -> bool:
        """Return whether pictures or an animation follow the numbers."""
        return self.problem.report.figures or self.animation


def planning_command(answer: Callable[[Asked], int]) -> Callable[..., int]:
    """Return a command with the name and help of `answer`, which returns the exit code."""

    def command(options: PlanningOptions) -> int:
        return _answered(answer, options)

    return with_options(PlanningOptions)(_named(command, answer))


def driving_command(answer: Callable[[Asked], int]) -> Callable[..., int]:
    """Return a planning command for a run, which can be animated."""

    def command(options: PlanningOptions, animation: AnimationOption = False) -> int:
        return _answered(answer, options, animation)

    return with_options(PlanningOptions)(_named(command, answer))


def _answered(
    answer: Callable[[Asked], int], options: PlanningOptions, animation: bool = False
) -> int:
    """Load the problem, and answer."""
    from planopt.problems.overrides import with_overrides
    from planopt.problems.plausibility import problem_warnings
    from planopt.problems.systems import Request, SystemProblem, load_any

    horizon, planner, cost_to_go = options.horizon, options.planner, options.cost_to_go
    if animation and options.out is None:
        raise InputError(
            "an animation is saved in a folder", key="--animation", remedy="give --out"
        )
    found = load_any(options.problem)
    if isinstance(found, SystemProblem):
        from planopt.planning.files.saved import PLAN_FILE, PLAN_OR_RUN, RUN_FILE

        return answer_command(
            found,
            answer.__name__,
            Request(
                options.seed,
                () if horizon is None else (horizon,),
                () if planner is None else (planner,),
                animation=animation,
            ),
            out=options.out,
            json=options.json,
            replaced=PLAN_OR_RUN,
            file=PLAN_FILE if answer.__name__ == "solve" else RUN_FILE,
            not_for_it={
                "--cost-to-go": cost_to_go,
                "--animation": "run.gif" if animation and not found.system.animates else None,
            },
        )
    asked = with_overrides(found, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    for words in problem_warnings(asked):
        say(f"{asked.name}: {words}")
    return answer(Asked(asked, options.seed, options.out, options.json, animation))


def _named(command: Callable[Own, int], answer: Callable[[Asked], int]) -> Callable[Own, int]:
    command.__name__, command.__doc__ = answer.__name__, answer.__doc__
    return command
