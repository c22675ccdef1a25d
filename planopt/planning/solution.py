"""The answer to one planning problem: a plan for each robot, and what is needed to judge it."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planopt.channel.belief import Belief
from planopt.errors import A_FOLDER, path_of
from planopt.planning.explain.explanation import Crossing, Relaxation
from planopt.planning.plan import Plan, Verdict
from planopt.planning.short_results import only, short_solution
from planopt.planning.worth.situation import Aim
from planopt.problems.problem import Problem

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Solution:
    """One solved problem of one or several robots.

    Attributes
    ----------
    problem
        As solved (overrides applied).
    seed
        Of the ground truth's fading, the measured places and the first estimate of a target.
    belief
        The channel estimate that all plans were made from.
    plans, aims
        By robot: its plan, and the external inputs of its objective.
    explanation
        Changes that would give each robot a verified plan, and why verified plans cross coverage
        holes, where :func:`planopt.explain` was asked.

    Examples
    --------
    >>> import planopt
    >>> solution = planopt.solve(planopt.load("open_field"), horizon=2)
    >>> solution.verdict.value, len(solution.plans), len(solution.plan.t_s)
    ('verified', 1, 3)
    """

    problem: Problem
    seed: int
    belief: Belief
    plans: tuple[Plan, ...]
    aims: tuple[Aim, ...]
    explanation: tuple[Relaxation | Crossing, ...] = ()

    def __repr__(self) -> str:
        """Return what was solved, the verdict, and a line for each plan."""
        return short_solution(self.problem, self.seed, self.plans)

    @property
    def plan(self) -> Plan:
        """The plan of the only robot; use `plans` if there are several.

        Raises
        ------
        InputError
            There are several robots.
        """
        return only(self.plans, "plans")

    @property
    def verdict(self) -> Verdict:
        """The worst of the plans' verdicts."""
        return max((plan.verdict for plan in self.plans), key=list(Verdict).index)

    def plot(self) -> Figure:
        """Draw the plans on the map with their predictions; no window is opened.

        Returns
        -------
        matplotlib.figure.Figure
            Notebooks show it; ``figure.savefig("plan.png")`` writes it.
        """
        # Named, not imported: the drawing package is above this one.
        return import_module("planopt.report.motion_figures").draw_solution(self)

    def save(self, folder: Path | str) -> None:
        """Save the plans as a folder that ``planopt check`` and :func:`planopt.load_result` read.

        Parameters
        ----------
        folder
            Made if it is missing; a plan or run that it had is replaced.

        Raises
        ------
        OutputError
            The folder cannot be written; what it had is still there.
        InputError
            The problem has parts from Python, which no file can hold.
        """
        from planopt.planning.files.saved import save_solution

        save_solution(self, path_of("folder", folder, A_FOLDER))

    def to_dataframe(self) -> Any:
        """Return the plans as a pandas DataFrame: a row for each place of each robot.

        Returns
        -------
        pandas.DataFrame
            Columns as in ``steps.csv``; those of the ground truth are empty.

        Raises
        ------
        InputError
            pandas is not installed.
        """
        from planopt.files.tables import dataframe
        from planopt.planning.files.run_tables import step_columns, steps_of_plans

        return dataframe(step_columns(self.problem), steps_of_plans(self.problem, self.plans))


def exit_code(solution: Solution) -> int:
    """Return 0 if every plan is verified, 4 if there is no plan, else 3."""
    return {Verdict.VERIFIED: 0, Verdict.NONE: 4}.get(solution.verdict, 3)
