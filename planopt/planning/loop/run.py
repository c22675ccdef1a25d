"""A closed loop's log: what was driven, predicted, true, and which rung released it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Rung, Verdict
from planopt.robots.drive import Drive
from planopt.short_repr import short_repr


class Outcome(StrEnum):
    """How a closed loop ended."""

    REACHED = "reached"
    STALLED = "stalled"
    STEP_LIMIT = "step_limit"
    NO_PLAN = "no_plan"
    COMPLETED = "completed"


@dataclass(frozen=True)
class StepLog:
    """Columns over the steps of one robot's run; row 0 is the start.

    All arrays have length ``steps + 1``. ``rung`` and ``verdict`` of a row belong to the plan
    that led there (row 0: ``plan``/``verified`` by convention).

    Attributes
    ----------
    t_s, positions_m
        Time and ``(x, y)``.
    predicted_dbm, deviation_db, connectivity
        Prediction for this place *before* it was measured, by the plan that led there.
    true_dbm, connected
        Truth at this place.
    step_s
        Wall time that planning this step took; row 0 is 0.
    polish_gain_s
        How much better than the lattice path the released one is, in the objective's unit (seconds
        for a cost); row 0 is 0.
    relaxation_db
        By how much the bound was relaxed at this step (0: not).
    """

    t_s: NDArray[np.float64]
    positions_m: NDArray[np.float64]
    predicted_dbm: NDArray[np.float64]
    deviation_db: NDArray[np.float64]
    connectivity: NDArray[np.float64]
    true_dbm: NDArray[np.float64]
    connected: NDArray[np.bool_]
    step_s: NDArray[np.float64]
    polish_gain_s: NDArray[np.float64]
    relaxation_db: NDArray[np.float64]
    rung: tuple[Rung, ...]
    verdict: tuple[Verdict, ...]

    __repr__ = short_repr


@dataclass(frozen=True)
class Metrics:
    """What a run is judged by.

    Attributes
    ----------
    goal_time_s
        Time to the goal; NaN if it was not reached.
    path_m
        Driven length.
    true_connected_share
        Share of steps connected in truth.
    longest_outage_m
        Longest driven length without a true connection.
    predicted_min_connectivity
        Least predicted P(connected) over the released steps.
    polish_gain
        Mean relative gain of the polish over the lattice start.
    measured_steps
        How many steps brought a measurement.
    """

    goal_time_s: float
    path_m: float
    true_connected_share: float
    longest_outage_m: float
    predicted_min_connectivity: float
    polish_gain: float
    measured_steps: int


@dataclass(frozen=True)
class Run:
    """One closed loop.

    Attributes
    ----------
    robot
        Its name.
    horizon, planner, cost_to_go, seed
        What was run.
    outcome, reason
        How it ended, and why in words.
    log, metrics
        See their types.
    rule
        What was kept of a rule of connectivity other than p_min at each step, by metric.
    drive
        States and inputs over the steps; None for the single integrator.
    costs
        On the way to a goal: what the run cost at the outage price, by metric.
    """

    robot: str
    horizon: int
    planner: str
    cost_to_go: str | None
    seed: int
    outcome: Outcome
    reason: str
    log: StepLog
    metrics: Metrics
    rule: dict[str, float] = field(default_factory=dict[str, float])
    drive: Drive | None = None
    costs: dict[str, float] = field(default_factory=dict[str, float])

    __repr__ = short_repr

    @property
    def all_metrics(self) -> dict[str, float]:
        """Every metric by name."""
        return {**asdict(self.metrics), **self.rule, **self.costs}

    @property
    def verified_rate(self) -> float:
        """Share of released steps whose plan was verified (1 if none was released)."""
        released = self.log.verdict[1:]
        return sum(v is Verdict.VERIFIED for v in released) / len(released) if released else 1.0

    @property
    def rungs(self) -> dict[str, int]:
        """How often each rung released a step."""
        counts: dict[str, int] = {}
        for rung in self.log.rung[1:]:
            counts[rung.value] = counts.get(rung.value, 0) + 1
        return counts
