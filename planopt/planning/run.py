"""The answer to one closed-loop simulation of one or several robots."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planopt.channel.belief import Belief
from planopt.channel.fields.truth import Truth
from planopt.errors import A_FOLDER, path_of
from planopt.planning.holes import BlockedWay
from planopt.planning.loop.log import ChannelLog, Outcome, RobotRun, TargetLog
from planopt.planning.loop.metrics import run_metrics
from planopt.planning.plan import Plan
from planopt.planning.short_results import only, short_run
from planopt.planning.worth.situation import Aim
from planopt.problems.problem import Problem

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Run:
    """One closed loop of all robots of a problem.

    Attributes
    ----------
    problem
        As run (overrides applied).
    seed
        Of everything that happens.
    truths
        By station: the ground truth that was driven in; empty where a saved run's is not to be had.
    runs, plans, aims, beliefs
        By robot: its log, its released plans, one a step, the external inputs of their objectives,
        and its channel estimate at the end.
    first_measurements
        How many of a belief's measurements were there before the run.
    target
        None if nothing is tracked.
    channel
        How well the channel was known; None on the way to a goal.
    costs
        On the way to a goal: cost of the run at the outage price, by metric.
    blocked
        Where a hard bound on connectivity ended the run: the cheapest ways, which it forbids.

    Examples
    --------
    >>> import planopt
    >>> run = planopt.simulate(planopt.load("open_field"), horizon=2)
    >>> run.outcome.value, run.verified_rate, len(run.plans[0]) == len(run.run.log.t_s) - 1
    ('reached', 1.0, True)
    """

    problem: Problem
    seed: int
    truths: tuple[Truth, ...]
    runs: tuple[RobotRun, ...]
    plans: tuple[tuple[Plan, ...], ...]
    aims: tuple[tuple[Aim, ...], ...]
    beliefs: tuple[Belief, ...]
    first_measurements: int
    target: TargetLog | None = None
    channel: ChannelLog | None = None
    costs: dict[str, float] = field(default_factory=dict[str, float])
    blocked: tuple[BlockedWay, ...] = ()

    def __repr__(self) -> str:
        """Return what was run, how it ended, and its metrics."""
        return short_run(self.problem, self.seed, self.runs, self.metrics)

    @property
    def run(self) -> RobotRun:
        """The log of the only robot; use `runs` if there are several.

        Raises
        ------
        InputError
            There are several robots.
        """
        return only(self.runs, "runs")

    @property
    def belief(self) -> Belief:
        """The channel estimate of the only robot at the end; use `beliefs` if there are several.

        Raises
        ------
        InputError
            There are several robots.
        """
        return only(self.beliefs, "beliefs")

    @property
    def outcome(self) -> Outcome:
        """Return how the run ended."""
        return self.runs[0].outcome

    @property
    def reason(self) -> str:
        """Return why it ended, in words."""
        return self.runs[0].reason

    @property
    def metrics(self) -> dict[str, float]:
        """Metrics of all robots together, by name."""
        return run_metrics(self.problem, self.runs, self.target, self.channel, self.costs)

    @property
    def verified_rate(self) -> float:
        """Share of all released steps whose plan was verified (NaN if none was released)."""
        return float(np.mean([run.verified_rate for run in self.runs]))

    @property
    def rungs(self) -> dict[str, int]:
        """Return how often each fallback released a step, over all robots."""
        counts: Counter[str] = Counter()
        for run in self.runs:
            counts.update(run.rungs)
        return dict(counts)

    def plot(self) -> Figure:
        """Draw where the robots drove on the map; no window is opened.

        Returns
        -------
        matplotlib.figure.Figure
            Notebooks show it; ``figure.savefig("run.png")`` writes it.
        """
        # Named, not imported: the drawing package is above this one.
        return import_module("planopt.report.motion_figures").draw_run(self)

    def save(self, folder: Path | str) -> None:
        """Save the run as a folder that ``planopt check`` and :func:`planopt.load_result` read.

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
        from planopt.planning.files.saved import save_run

        save_run(self, path_of("folder", folder, A_FOLDER))

    def to_dataframe(self) -> Any:
        """Return the run as a pandas DataFrame: a row for each robot and step, the start first.

        Returns
        -------
        pandas.DataFrame
            Columns as in ``steps.csv``.

        Raises
        ------
        InputError
            pandas is not installed.
        """
        from planopt.files.tables import dataframe
        from planopt.planning.files.run_tables import step_columns, steps_of_runs

        return dataframe(step_columns(self.problem), steps_of_runs(self.problem, self.runs))
