"""A calibrated law of connection goes only with what is computed from single probabilities."""

from __future__ import annotations

from planopt.errors import InputError
from planopt.problems.problem import Problem

KEY = "channel.calibration"
NORMAL = "leave the key out"


def check_calibration(problem: Problem) -> None:
    """Raise what keeps a calibrated problem from being planned with.

    Raises
    ------
    InputError
        All parameters are to count as uncertain besides, or a term of the objective rests on the
        normal law of several places together.
    """
    if problem.channel.calibration == "none":
        return
    if problem.constraints.rule.parameter_uncertainty == "all":
        raise InputError(
            f'is "{problem.channel.calibration}", which takes the parameters as estimated, and '
            'constraints.parameter_uncertainty is "all"',
            file=problem.file,
            key=KEY,
            remedy=f"{NORMAL}, or ask for path_loss: outcomes show what the estimate misses",
        )
    for number, term in enumerate(problem.terms):
        words = term.calibration_fault
        if words is not None:
            raise InputError(
                f'is "{problem.channel.calibration}", and {words}',
                file=problem.file,
                key=KEY,
                remedy=f"{NORMAL}, or change objective.terms[{number}]",
            )
