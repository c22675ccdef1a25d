"""Results of planning: the solution of a problem, and the run of a closed loop."""

import math
from abc import abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.bounds.bound import Bound, total_bound
from planopt.channel.ground_truth import Truth
from planopt.channel.posterior import Belief
from planopt.errors import A_FOLDER, InputError, path_of
from planopt.files.tables import encoded
from planopt.objectives.terms.term import Aim
from planopt.planning.certificate import BlockedPath, Crossing, Relaxation
from planopt.planning.loop.log import ChannelLog, Outcome, RobotRun, TargetLog
from planopt.planning.loop.metrics import run_metrics
from planopt.planning.plan import Plan, Verdict
from planopt.problems.problem import Problem
from planopt.problems.tasks import Result
from planopt.short_repr import LINES, wrapped
from planopt.world.geodesy import Origin

_Entry = TypeVar("_Entry")

ARRIVED = (Outcome.REACHED, Outcome.COMPLETED)  # Outcomes of runs that completed their task


@dataclass(frozen=True, eq=False, repr=False)
class MotionResult(Result):
    """Base class of results of motion planning: a problem with overrides applied, and a seed."""

    problem: Problem
    seed: int

    @property
    def data(self) -> Mapping[str, Any]:
        """Return the JSON object of the result."""
        return self.task.data(self)

    def __eq__(self, other: object) -> bool:
        """Return whether two results have the same content, apart from computation times."""
        if type(self) is not type(other):
            return False
        own, found = ({**each.data, "step_s": None} for each in (self, cast("MotionResult", other)))
        return own == found

    def __hash__(self) -> int:
        return hash((type(self), self.problem.name, self.seed))

    def to_nav2(
        self,
        folder: Path | str,
        *,
        keepout_below: float = 0.1,
        p_min: float | None = None,
        cell_m: float | None = None,
        robot: int = 0,
    ) -> None:
        """Write filter masks for Nav2 from the channel belief (of a run: the final one).

        The masks are ``keepout``, ``weighted`` (100 (1 - P)) and ``contact``, with P the
        probability of connection to any station.

        Parameters
        ----------
        folder
            Folder, created if missing; masks in it are replaced.
        keepout_below
            Probability of connection below which a cell is forbidden by ``keepout``.
        p_min
            Probability from which ``contact`` predicts contact; default: ``constraints.p_min``.
        cell_m
            Cell side in metres; default: 200 cells along the longer side.
        robot
            Number of the robot whose belief is used.

        Raises
        ------
        InputError
            A limit is not a probability, or the cells are too small.
        OutputError
            The folder cannot be written.
        """
        masks = import_module("planopt.planning.files.path_files")
        belief, place = self.belief_of(robot), path_of("folder", folder, A_FOLDER)
        masks.save_masks(self.problem, belief, place, keepout_below, p_min, cell_m)

    def save_path(
        self,
        file: Path | str,
        *,
        robot: int | str = 0,
        origin_deg: Origin | None = None,
        altitude_m: float = 0.0,
    ) -> None:
        """Write the path of a robot for other programs: the plan, or the driven path of a run.

        Parameters
        ----------
        file
            File ending in ``.json`` (nav_msgs/Path), ``.geojson``, ``.plan`` (QGroundControl) or
            ``.csv``.
        robot
            Number or name of the robot.
        origin_deg
            Latitude and longitude of (0, 0), for files in degrees; default: origin of the log.
        altitude_m
            Altitude of the waypoints above the start.

        Raises
        ------
        InputError
            The ending or the robot is unknown, or the file needs an origin.
        OutputError
            The file cannot be written.
        """
        files = import_module("planopt.planning.files.path_files")
        path = files.path_of_result(self, robot)
        files.save_path(path, path_of("file", file, "give a file name"), origin_deg, altitude_m)

    def save_recording(self, file: Path | str) -> None:
        """Write the result as a recording: poses, plans and powers over time, obstacles, the map.

        Parameters
        ----------
        file
            File ending in ``.mcap`` (JSON messages with the schemas of Foxglove; needs the extra
            ``ros``) or ``.rrd`` (Rerun; needs the extra ``rerun``).

        Raises
        ------
        InputError
            The ending is unknown, or the package is not installed.
        OutputError
            The file cannot be written.
        """
        recordings = import_module("planopt.planning.files.path_files")
        recordings.save_recording(self, path_of("file", file, "give a file name"))

    @abstractmethod
    def belief_of(self, robot: int) -> Belief:
        """Return the channel belief of a robot."""


@dataclass(frozen=True, eq=False, repr=False)
class Solution(MotionResult):
    """Solved problem of one or several robots.

    Attributes
    ----------
    problem
        Problem as solved, with overrides applied.
    seed
        Random seed of fading, measurement positions and the first estimate of a target.
    belief
        Channel belief on which all plans are based.
    plans, aims
        Plan of each robot, and external inputs of its objective.
    explanation
        Result of :func:`planopt.explain`, if it was called: changes that would give each robot a
        verified plan, and reasons why verified plans cross coverage holes.

    Examples
    --------
    >>> import planopt
    >>> solution = planopt.solve(planopt.load("open_field"), horizon=2)
    >>> solution.verdict.value, len(solution.plans), len(solution.plan.t_s)
    ('verified', 1, 3)
    """

    belief: Belief
    plans: tuple[Plan, ...]
    aims: tuple[Aim, ...]
    explanation: tuple[Relaxation | Crossing, ...] = ()

    def __repr__(self) -> str:
        """Return the problem and the verdict of each plan, in at most five lines."""
        lines: list[str] = []
        for plan in self.plans:
            clearance = plan.certificate.min_clearance_m
            lines.append(
                f"{plan.robot}: {plan.verdict.value} ({plan.rung.value}, "
                f"{plan.termination.value}), objective {plan.objective:.4g}, "
                + (f"clearance {clearance:.4g} m, " if math.isfinite(clearance) else "")
                + f"least P(connected) {np.min(plan.connectivity[1:], initial=1.0):.4f}"
            )
        horizon = len(self.plans[0].t_s) - 1
        head = f"solution of {self.problem.name}, horizon {horizon}, seed {self.seed}"
        return _listed(head, lines, most=LINES - 1)

    def belief_of(self, robot: int) -> Belief:
        """Return the shared channel belief."""
        return self.belief

    @property
    def plan(self) -> Plan:
        """Return the plan of the only robot; with several robots use `plans`."""
        return _only(self.plans, "plans")

    @property
    def verdict(self) -> Verdict:
        """Return the worst verdict of all plans."""
        return max((plan.verdict for plan in self.plans), key=list(Verdict).index)

    @property
    def bound(self) -> Bound | None:
        """Return the bound on the sum of all objectives; None without a complete proof."""
        bounds = [plan.bound for plan in self.plans if plan.bound is not None]
        complete = bounds and len(bounds) == len(self.plans)
        return total_bound(bounds, self.problem.sense) if complete else None

    @property
    def exit_code(self) -> int:
        """Return 0 if every plan is verified, 4 if there is no plan, else 3."""
        return {Verdict.VERIFIED: 0, Verdict.NONE: 4}.get(self.verdict, 3)


@dataclass(frozen=True, eq=False, repr=False)
class Run(MotionResult):
    """Closed-loop run of all robots of a problem.

    Attributes
    ----------
    problem
        Problem as simulated, with overrides applied.
    seed
        Random seed of the run.
    truths
        Simulated ground truth of each station; empty if not available for a saved run.
    runs, plans, aims, beliefs
        Entries per robot: log and metrics; released plans, one per step; external inputs of their
        objectives; final channel belief.
    first_measurements
        Number of initial measurements in each belief.
    target
        Log of the target; None if nothing is tracked.
    channel
        Errors of the first robot's channel estimate; None for runs to a goal.
    costs
        Realised costs of a run to goals, including the outage price, by metric.
    blocked
        Cheapest paths to goals if the run ended because a hard chance constraint forbids them.

    Examples
    --------
    >>> import planopt
    >>> run = planopt.simulate(planopt.load("open_field"), horizon=2)
    >>> run.outcome.value, run.verified_rate, len(run.plans[0]) == len(run.run.log.t_s) - 1
    ('reached', 1.0, True)
    """

    truths: tuple[Truth, ...]
    runs: tuple[RobotRun, ...]
    plans: tuple[tuple[Plan, ...], ...]
    aims: tuple[tuple[Aim, ...], ...]
    beliefs: tuple[Belief, ...]
    first_measurements: int
    target: TargetLog | None = None
    channel: ChannelLog | None = None
    costs: dict[str, float] = field(default_factory=dict[str, float])
    blocked: tuple[BlockedPath, ...] = ()

    def __repr__(self) -> str:
        """Return the problem, the outcome of each robot, and the metrics."""
        lines = [
            f"{run.robot}: {run.outcome.value} after {len(run.log.t_s) - 1} steps ({run.reason}), "
            + (
                f"{100.0 * run.verified_rate:.1f} % of the steps verified"
                if run.rungs
                else "no step was driven"
            )
            for run in self.runs
        ]
        horizon, shown = self.problem.planner.horizon, self.metrics.items()
        head = f"run of {self.problem.name}, horizon {horizon}, seed {self.seed}"
        metrics = ", ".join(f"{name} {value:.4g}" for name, value in shown)
        return "\n".join([_listed(head, lines, most=LINES - 3), wrapped(f"  {metrics}", 2)])

    def belief_of(self, robot: int) -> Belief:
        """Return the final channel belief of a robot."""
        if not 0 <= robot < len(self.beliefs):
            raise InputError(
                f"is {robot}, and there are {len(self.beliefs)} robots",
                key="robot",
                remedy="give a number from 0 on",
            )
        return self.beliefs[robot]

    @property
    def run(self) -> RobotRun:
        """Return log and metrics of the only robot; with several robots use `runs`."""
        return _only(self.runs, "runs")

    @property
    def belief(self) -> Belief:
        """Return the final channel belief of the only robot; with several robots use `beliefs`."""
        return _only(self.beliefs, "beliefs")

    @property
    def outcome(self) -> Outcome:
        """Return the outcome of the run."""
        return self.runs[0].outcome

    @property
    def reason(self) -> str:
        """Return the reason of the outcome as text."""
        return self.runs[0].reason

    @property
    def metrics(self) -> dict[str, float]:
        """Return the metrics of all robots combined, by name."""
        return run_metrics(self.problem, self.runs, self.target, self.channel, self.costs)

    @property
    def verified_rate(self) -> float:
        """Return the share of all released steps with a verified plan; NaN without steps."""
        return float(np.mean([run.verified_rate for run in self.runs]))

    @property
    def rungs(self) -> dict[str, int]:
        """Return the number of steps released by each fallback, over all robots."""
        return dict(sum((Counter(run.rungs) for run in self.runs), Counter[str]()))

    @property
    def exit_code(self) -> int:
        """Return 0 for a completed task, 3 if some of its steps are not verified, 4 otherwise."""
        if self.outcome not in ARRIVED:
            return 4
        # Without steps the rate is NaN, and no step is unverified.
        return 3 if self.verified_rate < 1.0 else 0


def _only(several: Sequence[_Entry], name: str) -> _Entry:
    """Return the single entry of `several`; raise an InputError if there are more."""
    if len(several) != 1:
        raise InputError(
            f"the run has {len(several)} robots, and therefore no single result",
            remedy=f"use .{name}, which has one entry per robot",
        )
    return several[0]


def _listed(head: str, lines: Sequence[str], most: int) -> str:
    """Return `head`, followed by the first of `lines`, at most `most` lines in all."""
    if len(lines) > most:
        lines = [*lines[: most - 1], f"and {len(lines) - most + 1} more robots"]
    return "\n".join([head, *(f"  {line}" for line in lines)])


@dataclass(frozen=True, eq=False)
class RunSummary:
    """Summary of a run without its steps, as listed by comparisons."""

    horizon: int
    planner: str
    cost_to_go: str | None  # None if there is no goal
    seed: int
    outcome: str
    reason: str  # Reason of the outcome as text
    # 0 if the task was done with every step verified, 3 if some were not, 4 if it was not done
    exit_code: int
    # Metrics over all robots, by name
    metrics: dict[str, float] = field(default_factory=dict[str, float])
    # Number of steps released by each fallback, over all robots
    rungs: dict[str, int] = field(default_factory=dict[str, int])
    verified_rate: float = math.nan  # Share of steps with a verified plan
    # (steps x robots,) wall time of planning per step and robot
    step_s: Floats = field(default_factory=lambda: np.zeros(0))
    # (steps x robots,) predicted P(connected) and true connection; may be empty
    connectivity: Floats = field(default_factory=lambda: np.zeros(0))
    connected: Mask = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    problem: str = ""  # Name of the problem
    # Keys of the problem changed by a study, with their values
    sweep: Mapping[str, Any] = field(default_factory=dict[str, Any])
    # Series (steps + 1,) by name: trace_p in m^2 and normalised_trace_p of the station's target
    # estimate; rms_db, rms_without_multipath_db and path_loss_variance_db2 of the channel
    traces: Mapping[str, Floats] = field(default_factory=dict[str, Floats])

    def __eq__(self, other: object) -> bool:
        """Return whether two summaries have the same content, apart from computation times."""
        if not isinstance(other, RunSummary):
            return False
        own, found = (encoded(replace(each, step_s=np.zeros(0))) for each in (self, other))
        return own == found

    def __hash__(self) -> int:
        return hash((self.problem, self.horizon, self.planner, self.seed))


NOT_DONE = 4  # Exit code of runs that did not complete their task

CHANNEL_TRACES = ("rms_db", "rms_without_multipath_db", "path_loss_variance_db2")


def _traces(run: Run) -> dict[str, Floats]:
    """Return series of target and channel estimation errors over the steps of a run, by name."""
    found = dict[str, Floats]()
    if run.target is not None:
        found["trace_p"] = run.target.station_variance_m2
        found["normalised_trace_p"] = run.target.normalised_trace_p
    if run.channel is not None:
        found |= {name: getattr(run.channel, name) for name in CHANNEL_TRACES}
    return found


def summary_of(run: Run) -> RunSummary:
    """Return the summary of a run."""
    problem = run.problem
    return RunSummary(
        horizon=problem.planner.horizon,
        planner=problem.planner.name,
        cost_to_go=problem.cost_to_go,
        seed=run.seed,
        outcome=run.outcome.value,
        reason=run.reason,
        exit_code=run.exit_code,
        metrics=run.metrics,
        rungs=run.rungs,
        verified_rate=run.verified_rate,
        step_s=np.concatenate([one.log.step_s[1:] for one in run.runs]),
        connectivity=np.concatenate([one.log.connectivity[1:] for one in run.runs]),
        connected=np.concatenate([one.log.connected[1:] for one in run.runs]),
        problem=problem.name,
        traces=_traces(run),
    )
