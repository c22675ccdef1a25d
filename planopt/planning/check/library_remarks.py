"""How the problem in a saved file differs from the one of that name in the library.

Nothing in a file proves that its problem is the one that was meant: who edits ``p_min`` in it has
asked another question. What the library can tell is said; it is no reason to reject.
"""

from __future__ import annotations

from typing import Any

from planopt.errors import InputError
from planopt.planning.check.agreement import disagreements, in_words
from planopt.problems.library import SUFFIX, library_folder
from planopt.problems.load import load
from planopt.problems.problem import Problem
from planopt.problems.save import problem_to_dict


def library_remarks(file: str, problem: Problem) -> list[str]:
    """What to say of the problem in `file`; empty if it is the library's.

    Horizon, planner and cost to go may be others: the file says beside the problem what they are.
    """
    original = library_folder() / f"{problem.name}{SUFFIX}"
    if not original.is_file():
        return [
            f"{file}, key problem_file.problem.name: {problem.name} is no problem of the library, "
            "it is taken as it stands"
        ]
    try:
        meant = _but_overrides(problem_to_dict(load(original)))
    except InputError as error:
        return [f"{file}, key problem_file: cannot be compared with the library's: {error}"]
    said = _but_overrides(problem_to_dict(problem))
    return in_words(
        file,
        disagreements(said, meant, "problem_file"),
        f"in the library's {problem.name}",
    )


def _but_overrides(tables: dict[str, Any]) -> dict[str, Any]:
    """`tables` without what the command line may change."""
    without = {"planner": ("horizon", "name"), "objective": ("cost_to_go",)}
    return {
        table: {key: value for key, value in keys.items() if key not in without[table]}
        if table in without
        else keys
        for table, keys in tables.items()
    }
