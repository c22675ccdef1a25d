"""Commands on problems of a system: ask it, save its files, show its words."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from planopt.commands.output import drawing, progress, results_folder, show
from planopt.errors import InputError

if TYPE_CHECKING:
    from planopt.files.result_folder import ResultFiles
    from planopt.problems.systems import Request, SystemProblem


def answer_command(
    problem: SystemProblem,
    action: str,
    request: Request,
    *,
    out: Path | None,
    json: bool,
    replaced: ResultFiles,
    file: str,
    not_for_it: dict[str, str | None],
) -> int:
    """Do what a command asks, and return the exit code.

    Parameters
    ----------
    problem, action, request
        What is asked of whom.
    out, json
        The options of these names.
    replaced, file
        What the answer replaces in a folder, and its JSON file.
    not_for_it
        Values of options that only motion planning has; None if not given.
    """
    from dataclasses import replace

    from planopt.files.result_folder import ResultFiles, replaced_results
    from planopt.files.whole import strict_text, write_text

    for option, value in not_for_it.items():
        if value is not None:
            raise InputError(
                f"is not for the task {problem.task}", key=option, remedy="leave it out"
            )
    files = ResultFiles(replaced.kind, (*replaced.patterns, *problem.system.files))
    with results_folder(out) as folder:
        with progress(f"{action}, steps:") as advance:
            answer = problem.answer(action, replace(request, on_step=advance))
        if folder is not None:
            with replaced_results(folder, files, pictures_follow=answer.draw is not None) as new:
                answer.save(new)
                record = {**answer.data, "problem_file": problem.tables()}
                write_text(new / file, strict_text(record))
        show(json, answer.data, "\n".join(answer.words))
        with drawing(folder, files, wanted=answer.draw is not None) as new:
            if new is not None and answer.draw is not None:
                answer.draw(new)
    return answer.exit_code
