"""What the commands that plan are asked for: one list of options for all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from planopt.commands.options import (
    CalibrationOption,
    CostToGoOption,
    HorizonOption,
    JsonOption,
    OutOption,
    PlannerOption,
    ProblemArgument,
    SeedOption,
)

if TYPE_CHECKING:
    from planopt.problems.problem import Problem


@dataclass(frozen=True)
class Asked:
    """What was asked for on the command line.

    Attributes
    ----------
    problem
        With horizon, planner, cost to go and calibration as asked for.
    seed, out, json
        The options of these names.
    """

    problem: Problem
    seed: int
    out: Path | None
    json: bool


def planning_command(answer: Callable[[Asked], int]) -> Callable[..., int]:
    """A command of the name and help of `answer`, which gives its exit code."""

    def command(
        problem: ProblemArgument,
        horizon: HorizonOption = None,
        planner: PlannerOption = None,
        cost_to_go: CostToGoOption = None,
        calibration: CalibrationOption = None,
        seed: SeedOption = 0,
        out: OutOption = None,
        json: JsonOption = False,
    ) -> int:
        from planopt.problems.overrides import with_overrides
        from planopt.problems.systems import Request, SystemProblem, load_any

        found = load_any(problem)
        if isinstance(found, SystemProblem):
            from planopt.commands.systems import answer_command
            from planopt.planning.files.saved import PLAN_FILE, PLAN_OR_RUN, RUN_FILE

            return answer_command(
                found,
                answer.__name__,
                Request(
                    seed,
                    () if horizon is None else (horizon,),
                    () if planner is None else (planner,),
                ),
                out=out,
                json=json,
                replaced=PLAN_OR_RUN,
                file=PLAN_FILE if answer.__name__ == "solve" else RUN_FILE,
                not_for_it={"--cost-to-go": cost_to_go, "--calibration": calibration},
            )
        asked = with_overrides(
            found,
            horizon=horizon,
            planner=planner,
            cost_to_go=cost_to_go,
            calibration=calibration,
        )
        return answer(Asked(asked, seed, out, json))

    # Not functools.wraps: the signature that Typer reads is the one above.
    command.__name__, command.__doc__ = answer.__name__, answer.__doc__
    return command
