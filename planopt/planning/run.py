"""The answer to one closed-loop simulation of one or several robots."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

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

ARRIVED = (Outcome.REACHED, Outcome.COMPLETED)
"""Outcomes of runs that did what the problem asks."""


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
        from planopt.planning.files.steps_file import joined_steps, steps_dataframe, steps_of_run

        tables = [steps_of_run(one.robot, one.log, one.drive) for one in self.runs]
        return steps_dataframe(joined_steps(tables))


def exit_code(run: Run) -> int:
    """Return 0 if the task was done with every step verified, 3 if some was not, 4 if not done."""
    if run.outcome not in ARRIVED:
        return 4
    # Without a step there is nothing that was not verified.
    return 3 if run.verified_rate < 1.0 else 0


@dataclass(frozen=True, eq=False)
class RunSummary:
    """A run without its steps, as comparisons list it."""

    horizon: int  # What was run; `cost_to_go` is None if there is no goal
    planner: str
    cost_to_go: str | None
    seed: int
    outcome: str  # How it ended, and why in words
    reason: str
    # 0 if it did what the problem asks with every step verified, 3 if some was not, 4 if it did not
    exit_code: int
    metrics: dict[str, float]  # Of all robots together, by name
    rungs: dict[str, int]  # How often each fallback released a step, over all robots
    # Share of all released steps whose plan was verified; NaN where nothing is to be verified
    verified_rate: float
    # (steps x robots,) wall time that planning one step of one robot took
    step_s: NDArray[np.float64]
    # (steps x robots,) predicted probability of connection after each step, and whether there was
    # one; empty where no channel is learnt
    connectivity: NDArray[np.float64]
    connected: NDArray[np.bool_]
    problem: str = ""  # Name of the problem
    # Keys of the problem that a study changed, with their values
    sweep: Mapping[str, Any] = field(default_factory=dict[str, Any])
    # (steps + 1,) each, by name: trace_p, the trace in m^2 of the station's covariance of the
    # target's position, normalised_trace_p, the same over that of the first estimate, and of the
    # channel rms_db, rms_without_multipath_db and path_loss_variance_db2; empty on the way to a
    # goal
    traces: Mapping[str, NDArray[np.float64]] = field(
        default_factory=dict[str, NDArray[np.float64]]
    )


CHANNEL_TRACES = ("rms_db", "rms_without_multipath_db", "path_loss_variance_db2")


def _traces(run: Run) -> dict[str, NDArray[np.float64]]:
    """Return what was known over the steps of a run, by name."""
    found = dict[str, NDArray[np.float64]]()
    if run.target is not None:
        found["trace_p"] = run.target.station_variance_m2
        found["normalised_trace_p"] = run.target.normalised_trace_p
    if run.channel is not None:
        found |= {name: getattr(run.channel, name) for name in CHANNEL_TRACES}
    return found


def summary_of(run: Run) -> RunSummary:
    """Summarise a run."""
    problem = run.problem
    return RunSummary(
        horizon=problem.planner.horizon,
        planner=problem.planner.name,
        cost_to_go=problem.cost_to_go,
        seed=run.seed,
        outcome=run.outcome.value,
        reason=run.reason,
        exit_code=exit_code(run),
        metrics=run.metrics,
        rungs=run.rungs,
        verified_rate=run.verified_rate,
        step_s=np.concatenate([one.log.step_s[1:] for one in run.runs]),
        connectivity=np.concatenate([one.log.connectivity[1:] for one in run.runs]),
        connected=np.concatenate([one.log.connected[1:] for one in run.runs]),
        problem=problem.name,
        traces=_traces(run),
    )
