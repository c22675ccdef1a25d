"""Judge a plan: clearance, motion, connectivity, from the problem and the belief alone.

Imports nothing of the transcription or the solvers. A plan is verified when the whole swept path
keeps the clearance, the workspace and its distance from all that moves, every step keeps the speed,
and the rule of connectivity holds by the exact posterior and today's deviation. Single steps may
miss it where nothing keeps it, on the way to a goal where no path is cheaper at the outage price
(:mod:`planopt.planning.proof.single_steps`). A threshold that is met nowhere is an answer,
not a plan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.certificate import Certificate
from planopt.planning.plan import Verdict
from planopt.planning.proof.circumstances import Circumstances, obstacles_ahead
from planopt.planning.proof.motion import is_at_goal, judge_apart, judge_motion, swept_motion
from planopt.planning.proof.predictions import certified_prediction
from planopt.planning.proof.rules.rule import PathCase, rule_reasons, whole_plan_result
from planopt.planning.proof.single_steps import judge_single_steps
from planopt.planning.tolerances import STANDSTILL_M
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive
from planopt.world.clearance import ObstacleIndex

UNCOMPARED = (
    "steps are below constraints.p_min, and the verifier's grid, half a step wide, has no path "
    "from here to the goal to compare the plan with"
)
STANDING = "the plan stands still short of the goal, and nothing that moves is in its way"


@dataclass(frozen=True)
class Judgement:
    """The verdict on a path, and the prediction that it rests on.

    Attributes
    ----------
    certificate, verdict
        See their types.
    power
        At every place of the path, the robot's own first; None if the path is not finite.
    sound
        Whether clearance, bounds, motion model and the distance from what moves are kept, whatever
        connectivity is.
    """

    certificate: Certificate
    verdict: Verdict
    power: Prediction | None
    sound: bool = False


def verify(
    problem: Problem,
    index: ObstacleIndex,
    posterior: ChannelPosterior,
    start_m: NDArray[np.float64],
    positions_m: NDArray[np.float64],
    kkt_residual: float | None = None,
    circumstances: Circumstances | None = None,
    drive: Drive | None = None,
) -> tuple[Certificate, Verdict]:
    """Certificate and verdict of a path: see :func:`judge`."""
    judgement = judge(
        problem, index, posterior, start_m, positions_m, kkt_residual, circumstances, drive
    )
    return judgement.certificate, judgement.verdict


def judge(
    problem: Problem,
    index: ObstacleIndex,
    posterior: ChannelPosterior,
    start_m: NDArray[np.float64],
    positions_m: NDArray[np.float64],
    kkt_residual: float | None = None,
    circumstances: Circumstances | None = None,
    drive: Drive | None = None,
) -> Judgement:
    """Judge a path (N + 1, 2) of the problem's first robot, which is at `start_m`.

    Parameters
    ----------
    problem, index
        The problem and the index of its obstacles.
    posterior
        What is believed of the channel; of the first station's, if `circumstances` has several.
    start_m, positions_m
        Where the robot is (its whole state, where it has more than a place), and the planned path
        from there.
    kkt_residual
        Passed on into the certificate.
    circumstances
        What it is judged under; None for the problem's moving obstacles from time 0 on alone.
    drive
        How the robot drives along the path; None for the single integrator.
    """
    constraints = problem.constraints
    radio = problem.stations[0]
    if not np.isfinite(positions_m).all():
        broken = Certificate(0.0, 0.0, float("inf"), kkt_residual, "exact", reasons=("not finite",))
        return Judgement(broken, Verdict.VIOLATED, None)
    under = circumstances or Circumstances(obstacles_ahead(problem, 0))
    motion = judge_motion(problem, index, start_m, positions_m, drive)
    reasons = list(motion.reasons)
    swept = swept_motion(problem, positions_m, drive)
    apart = judge_apart(under.moving, swept, len(positions_m) - 1)
    reasons += apart.reasons

    power, kind = certified_prediction(posterior, positions_m, under.broad)
    mean, deviation = power.mean_db[1:], power.deviation_db[1:]
    probability = connection_probability(mean, deviation, radio.threshold_dbm)
    result, steps = None, None
    if constraints.rule.by_step:
        steps = judge_single_steps(problem, under, index, posterior, start_m, positions_m, power)
        result = steps.result
        reasons += steps.reasons
    else:
        planned = Prediction(mean, deviation)
        result = whole_plan_result(
            PathCase(problem, under.history, posterior, positions_m, planned, under.broad)
        )
        reasons += rule_reasons(problem, result)
    certificate = Certificate(
        min_clearance_m=motion.clearance_m,
        min_connectivity=float(probability.min()),
        dynamics_defect=motion.defect_m,
        kkt_residual=kkt_residual,
        posterior=kind,
        relaxed_steps=() if steps is None else steps.relaxed_steps,
        relaxation_db=() if steps is None else steps.relaxation_db,
        best_margin_db=() if steps is None else steps.best_margin_db,
        path_cost_m=None if steps is None else steps.path_cost_m,
        best_cost_m=None if steps is None else steps.best_cost_m,
        step_cost_m=None if steps is None else steps.step_cost_m,
        step_excess_m=None if steps is None else steps.step_excess_m,
        reasons=tuple(reasons),
        min_separation_m=apart.min_separation_m,
        min_moving_clearance_m=apart.min_moving_clearance_m,
        rule=result,
    )
    verdict = Verdict.VIOLATED if reasons else Verdict.VERIFIED
    missing = [
        *([UNCOMPARED] if steps is not None and not steps.is_compared else []),
        *([STANDING] if _gets_nowhere(problem, under, positions_m, drive) else []),
    ]
    if missing and not reasons:
        certificate = replace(certificate, reasons=tuple(missing))
        verdict = Verdict.FEASIBLE_UNVERIFIED
    sound = not motion.reasons and not apart.reasons
    return Judgement(certificate, verdict, power, sound)


def _gets_nowhere(
    problem: Problem,
    under: Circumstances,
    positions_m: NDArray[np.float64],
    drive: Drive | None,
) -> bool:
    """Return whether a robot stands short of its goal, with nothing moving to wait for."""
    if problem.task != "reach" or len(under.moving) or is_at_goal(problem, positions_m[0]):
        return False
    track = positions_m if drive is None else drive.states
    return bool(np.abs(track - track[0]).max() <= STANDSTILL_M)
