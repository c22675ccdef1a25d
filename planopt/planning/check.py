"""Judge a saved plan or run again, from its files alone.

Nothing the planner computed is taken for granted: places come from ``steps.csv``, the channel is
conditioned again on the saved measurements, and the verifier decides. What the files say twice
must agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import connection_probability
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.belief_file import (
    SavedBelief,
    contradictions,
    first_posterior,
    grown_posterior,
)
from planopt.planning.plan import Certificate, Verdict
from planopt.planning.predictions import certified_prediction
from planopt.planning.run import Outcome
from planopt.planning.run_json import RunRecord
from planopt.planning.saved import STEPS_FILE, Saved, Steps, read_saved
from planopt.planning.solution_json import PlanRecord, RobotRecord
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.planning.verify import verify
from planopt.problems.problem import Problem
from planopt.world.clearance import (
    ObstacleIndex,
    containing_obstacle,
    index_obstacles,
    segment_lines,
    swept_clearance_m,
)

AGREEMENT = 1e-6
"""Numbers that the files say twice (metres, seconds) agree to this."""

PREDICTION_AGREEMENT = 1e-4
"""Predictions computed again (dB, probability) agree to this: another machine rounds otherwise."""


@dataclass(frozen=True)
class CheckResult:
    """What the check says.

    Attributes
    ----------
    verdict
        ``verified`` if there is nothing to object, else ``violated``; ``none`` for no plan.
    certificates
        What the verifier computed: one for a plan, one a step for a run.
    reasons
        Every objection; empty if verified.
    """

    verdict: Verdict
    certificates: tuple[Certificate, ...]
    reasons: tuple[str, ...]

    @property
    def certificate(self) -> Certificate | None:
        """The only one, or the worst of a run: its steps are those driven that miss the bound."""
        if len(self.certificates) <= 1:
            return self.certificates[0] if self.certificates else None
        return _worst(self.certificates)


@one_blas_thread()
def check(path: Path | str) -> CheckResult:
    """Judge a saved plan or run from its files.

    Parameters
    ----------
    path
        The folder, or its ``plan.json`` or ``run.json``.

    Raises
    ------
    InputError
        A file is missing, truncated or not what it should be; with file, key or row.
    """
    saved = read_saved(Path(path))
    record = saved.record
    if saved.steps is None or saved.belief is None:
        message = record.message or "the planner found no plan"
        return CheckResult(Verdict.NONE, (), (f"there is no plan to judge: {message}",))
    common = _common_reasons(saved, record.robots[0], saved.steps, saved.belief)
    if isinstance(record, PlanRecord):
        certificates, reasons = _check_plan(saved.problem, record, saved.steps, saved.belief)
    else:
        certificates, reasons = _check_run(saved.problem, record, saved.steps, saved.belief)
    reasons = (*common, *reasons)
    return CheckResult(
        Verdict.VIOLATED if reasons else Verdict.VERIFIED, tuple(certificates), reasons
    )


Judgement = tuple[list[Certificate], list[str]]


def _check_plan(
    problem: Problem, record: PlanRecord, steps: Steps, belief: SavedBelief
) -> Judgement:
    index = index_obstacles(problem.workspace)
    posterior = grown_posterior(belief, first_posterior(belief), len(belief.measurements))
    path = steps.positions_m
    reasons = _obstacles_met(problem, index, path)
    certificate, verdict = verify(
        problem,
        index,
        posterior,
        np.asarray(problem.robots[0].start_m),
        path,
        record.certificate.kkt_residual,
    )
    reasons += certificate.reasons
    if len(path) != problem.planner.horizon + 1:
        reasons.append(
            f"{len(path) - 1} steps are planned, planner.horizon is {problem.planner.horizon}"
        )
    if record.verdict is not verdict:
        reasons.append(f"plan.json says {record.verdict.value}, the verifier {verdict.value}")
    claims = (
        ("min_clearance_m", record.certificate.min_clearance_m, certificate.min_clearance_m),
        ("min_connectivity", record.certificate.min_connectivity, certificate.min_connectivity),
    )
    for name, claimed, found in claims:
        if not np.isclose(np.inf if claimed is None else claimed, found, 0, PREDICTION_AGREEMENT):
            reasons.append(f"plan.json, key certificate.{name}: {claimed}, found {found:.6g}")
    predicted = _predictions(problem, posterior, path)
    for step in range(len(path)):
        reasons += _disagreeing_prediction(steps, step, predicted[step])
    return [certificate], reasons + contradictions(belief, posterior)


def _check_run(problem: Problem, record: RunRecord, steps: Steps, belief: SavedBelief) -> Judgement:
    index = index_obstacles(problem.workspace)
    track = steps.positions_m
    posterior = first_posterior(belief)
    certificates: list[Certificate] = []
    reasons = _obstacles_met(problem, index, track)
    counts = [*belief.known_before_step.tolist(), len(belief.measurements)]
    for step, plan in enumerate(record.plans, start=1):
        posterior = grown_posterior(belief, posterior, counts[step - 1])
        path = np.stack([plan.x_m, plan.y_m], axis=1)
        certificate, verdict = verify(
            problem, index, posterior, track[step - 1], path, plan.kkt_residual
        )
        certificates.append(certificate)
        objections = list(certificate.reasons)
        if objections:
            objections[:0] = _obstacles_met(problem, index, path)
        if len(path) != problem.planner.horizon + 1:
            objections.append(
                f"has {len(path) - 1} steps, planner.horizon is {problem.planner.horizon}"
            )
        if plan.verdict is not verdict:
            objections.append(f"run.json says {plan.verdict.value}, the verifier {verdict.value}")
        reasons += [f"the plan for step {step}: {objection}" for objection in objections]
        if np.abs(path[:2] - track[step - 1 : step + 1]).max() > AGREEMENT:
            reasons.append(f"step {step} of {STEPS_FILE} is not the first step of its plan")
        reasons += _disagreeing_prediction(
            steps, step, _predictions(problem, posterior, path[1:2])[0]
        )
        new = belief.measurements.positions_m[counts[step - 1] : counts[step]]
        if (np.abs(new - track[step]) > AGREEMENT).any():
            reasons.append(
                f"{belief.file.name}: what was measured at step {step} is not from its place"
            )
    posterior = grown_posterior(belief, posterior, len(belief.measurements))
    reasons += _disagreeing_outcome(problem, record, steps)
    return certificates, reasons + contradictions(belief, posterior)


def _common_reasons(
    saved: Saved, robot: RobotRecord, steps: Steps, belief: SavedBelief
) -> list[str]:
    """What the JSON file and ``steps.csv`` say otherwise, and whether the belief belongs here."""
    reasons: list[str] = []
    claimed = {"t_s": robot.t_s, "x_m": robot.x_m, "y_m": robot.y_m}
    for name, column in claimed.items():
        differs = np.abs(np.array(column) - steps.numbers[name]) > AGREEMENT
        reasons += [
            f"step {step}: {name} is {steps.numbers[name][step]:.9g} in {STEPS_FILE} and "
            f"{column[step]:.9g} in {saved.file.name}"
            for step in np.nonzero(differs)[0].tolist()
        ]
    probability = np.array([np.nan if p is None else p for p in robot.connectivity])
    written = steps.numbers["connectivity"]
    if not np.allclose(probability, written, rtol=0, atol=AGREEMENT, equal_nan=True):
        reasons.append(f"connectivity is not the same in {STEPS_FILE} and {saved.file.name}")
    times = saved.problem.planner.step_s * np.arange(len(written))
    if not np.allclose(steps.numbers["t_s"], times, rtol=1e-12, atol=AGREEMENT):
        reasons.append(f"t_s in {STEPS_FILE} does not go in steps of planner.step_s")
    if belief.parameters.station != saved.problem.stations[0].site:
        reasons.append(f"{belief.file.name}: the station is not the problem's")
    return reasons


def _obstacles_met(
    problem: Problem, index: ObstacleIndex, path_m: NDArray[np.float64]
) -> list[str]:
    """Which waypoints lie in which obstacle, and which ways come too near to which."""
    reasons: list[str] = []
    inside: set[int] = set()
    for step, place in enumerate(path_m):
        obstacle = containing_obstacle(index, place)
        if obstacle is not None:
            inside.add(step)
            x, y = place
            reasons.append(f"step {step}: ({x:.3f}, {y:.3f}) lies in obstacle {obstacle.name}")
    limit = problem.constraints.clearance_m - CLEARANCE_TOLERANCE_M
    clearance = swept_clearance_m(index, path_m)
    lines = segment_lines(path_m[:-1], path_m[1:])
    for segment in np.nonzero(clearance < limit)[0].tolist():
        if segment in inside or segment + 1 in inside:
            continue
        nearest = index.obstacles[int(np.asarray(index.tree.nearest(lines[segment])))]
        reasons.append(
            f"step {segment + 1}: the way there comes within {clearance[segment]:.3f} m of "
            f"obstacle {nearest.name}"
        )
    return reasons


def _predictions(
    problem: Problem, posterior: ChannelPosterior, places_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Mean, deviation and P(connected) at each place; (n, 3)."""
    power = certified_prediction(posterior, places_m)[0]
    probability = connection_probability(
        power.mean_db, power.deviation_db, problem.stations[0].threshold_dbm
    )
    return np.stack([power.mean_db, power.deviation_db, probability], axis=1)


def _disagreeing_prediction(steps: Steps, step: int, found: NDArray[np.float64]) -> list[str]:
    names = ("predicted_db", "deviation_db", "connectivity")
    # A comparison with NaN, an empty cell, is false: it is reported.
    return [
        f"step {step}: {name} is {steps.numbers[name][step]:.6g} in {STEPS_FILE}, the belief "
        f"gives {value:.6g}"
        for name, value in zip(names, found.tolist(), strict=True)
        if not abs(steps.numbers[name][step] - value) <= PREDICTION_AGREEMENT
    ]


def _disagreeing_outcome(problem: Problem, record: RunRecord, steps: Steps) -> list[str]:
    """Whether the run ended and was connected as it says."""
    reasons: list[str] = []
    track, true = steps.positions_m, steps.numbers["true_db"]
    if np.abs(track[0] - problem.robots[0].start_m).max() > AGREEMENT:
        reasons.append("the run does not start at robots[0].start_m")
    missing = float(np.linalg.norm(track[-1] - problem.goal_m))
    reached = missing <= problem.constraints.goal_radius_m + AGREEMENT
    if reached != (record.outcome is Outcome.REACHED):
        reasons.append(
            f"run.json says {record.outcome.value}, the run ends {missing:.3f} m from the goal"
        )
    connected = np.array([flag == "1" for flag in steps.connected])
    differs = connected != (true >= problem.stations[0].threshold_dbm)
    reasons += [
        f"step {step}: connected does not go with true_db in {STEPS_FILE}"
        for step in np.nonzero(differs)[0].tolist()
    ]
    return reasons


def _worst(certificates: Sequence[Certificate]) -> Certificate:
    """The worst of a run's certificates in each respect."""
    residuals = [c.kkt_residual for c in certificates if c.kkt_residual is not None]
    missed = [
        (step, certificate)
        for step, certificate in enumerate(certificates, start=1)
        if 1 in certificate.relaxed_steps
    ]
    return Certificate(
        min_clearance_m=min(c.min_clearance_m for c in certificates),
        min_connectivity=min(c.min_connectivity for c in certificates),
        dynamics_defect=max(c.dynamics_defect for c in certificates),
        kkt_residual=max(residuals, default=None),
        posterior=certificates[-1].posterior,
        relaxed_steps=tuple(step for step, _ in missed),
        relaxation_db=tuple(c.relaxation_db[0] for _, c in missed),
        best_margin_db=tuple(c.best_margin_db[0] for _, c in missed if c.best_margin_db),
        no_connected_way=any(c.no_connected_way for c in certificates),
        reasons=tuple(reason for c in certificates for reason in c.reasons),
    )
