"""Verify a plan: clearance, motion, connectivity, from the problem and the belief alone.

Imports nothing of the transcription or the solvers. A plan is verified when the whole swept path
keeps the clearance, the workspace and its distance from all that moves, every step keeps the speed,
and the rule of connectivity holds by the exact posterior and today's deviation. Single steps may
miss it where nothing keeps it, on the way to a goal where no path is cheaper at the outage price
(:mod:`planopt.planning.proof.single_steps`). A threshold that is met nowhere is an answer,
not a plan.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.certificate import Certificate
from planopt.planning.plan import Verdict
from planopt.planning.proof.context import VerifierContext
from planopt.planning.proof.motion import is_at_goal, swept_motion, verify_apart, verify_motion
from planopt.planning.proof.predictions import certified_prediction
from planopt.planning.proof.rules.rule import PathCase, rule_reasons, whole_plan_result
from planopt.planning.proof.single_steps import StepsFinding, verify_single_steps
from planopt.planning.tolerances import STANDSTILL_M
from planopt.robots.drive import Drive

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
    context: VerifierContext,
    positions_m: NDArray[np.float64],
    kkt_residual: float | None = None,
    drive: Drive | None = None,
) -> Judgement:
    """Verify a path (N + 1, 2) of the context's robot.

    Parameters
    ----------
    context
        The problem, the belief, the robot's state and everything else that is known.
    positions_m
        The planned path from the robot's position on.
    kkt_residual
        Passed on into the certificate.
    drive
        How the robot drives along the path; None for the single integrator.
    """
    problem = context.problem
    if not np.isfinite(positions_m).all():
        broken = Certificate(0.0, 0.0, float("inf"), kkt_residual, "exact", reasons=("not finite",))
        return Judgement(broken, Verdict.VIOLATED, None)
    motion = verify_motion(problem, context.index, context.state, positions_m, drive)
    reasons = list(motion.reasons)
    swept = swept_motion(problem, positions_m, drive)
    apart = verify_apart(context.moving, swept, len(positions_m) - 1)
    reasons += apart.reasons

    power, kind = certified_prediction(context.law, positions_m)
    planned = Prediction(power.mean_db[1:], power.deviation_db[1:])
    probability = connection_probability(
        planned.mean_db, planned.deviation_db, problem.stations[0].threshold_dbm
    )
    if problem.constraints.rule.by_step:
        steps = verify_single_steps(context, positions_m, power)
    else:
        result = whole_plan_result(PathCase(context, positions_m, planned))
        steps = StepsFinding(reasons=tuple(rule_reasons(problem, result)), rule=result)
    reasons += steps.reasons
    found: dict[str, Any] = {key.name: getattr(steps, key.name) for key in fields(StepsFinding)}
    is_compared = found.pop("is_compared")
    found["reasons"] = tuple(reasons)
    certificate = Certificate(
        min_clearance_m=motion.clearance_m,
        min_connectivity=float(probability.min()),
        dynamics_defect=motion.defect_m,
        kkt_residual=kkt_residual,
        posterior=kind,
        min_separation_m=apart.min_separation_m,
        min_moving_clearance_m=apart.min_moving_clearance_m,
        **found,
    )
    verdict = Verdict.VIOLATED if reasons else Verdict.VERIFIED
    missing = [
        *([UNCOMPARED] if not is_compared else []),
        *([STANDING] if _gets_nowhere(context, positions_m, drive) else []),
    ]
    if missing and not reasons:
        certificate = replace(certificate, reasons=tuple(missing))
        verdict = Verdict.FEASIBLE_UNVERIFIED
    sound = not motion.reasons and not apart.reasons
    return Judgement(certificate, verdict, power, sound)


def _gets_nowhere(
    context: VerifierContext, positions_m: NDArray[np.float64], drive: Drive | None
) -> bool:
    """Return whether a robot stands short of its goal, with nothing moving to wait for."""
    problem = context.problem
    if problem.task != "reach" or len(context.moving) or is_at_goal(problem, positions_m[0]):
        return False
    track = positions_m if drive is None else drive.states
    return bool(np.abs(track - track[0]).max() <= STANDSTILL_M)
