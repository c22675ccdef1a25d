"""Judge a plan: clearance, motion, connectivity, from the problem and the belief alone.

Imports nothing of the transcription or the solvers. A plan is verified when the whole swept path
keeps the clearance and the workspace, every step keeps the speed, and the probability of connection
(exact posterior, today's deviation: theory 4.1) is at least p_min at every step where that is
possible. Where it is not possible is proven, not assumed. A step may miss the bound only if no
place within reach meets it by then, or if no way to the goal keeps it at all and the steps below it
lead across a gap by about the least length there is; and the bound must be
met at one step of the plan at least: a threshold that cannot be met is an answer, not a plan.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import bound_margin_db, connection_probability
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.planning.plan import Certificate, Verdict
from planopt.planning.proof.motion import judge_motion
from planopt.planning.proof.predictions import certified_prediction, search_prediction
from planopt.planning.proof.reachability import (
    MayReach,
    best_margins_by_step,
    connected_way_exists,
    least_outage_m,
)
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive
from planopt.world.clearance import ObstacleIndex

OUTAGE_LEEWAY_STEPS = 2.0
"""How much longer, in longest steps, a way through a gap may be than the least one."""


@dataclass(frozen=True)
class Judgement:
    """What the verifier says of a path, and the prediction that it rests on.

    Attributes
    ----------
    certificate, verdict
        See their types.
    power
        At every place of the path, the robot's own first; None if the path is not finite.
    sound
        Whether clearance, bounds and motion model are kept, whatever connectivity is.
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
    drive: Drive | None = None,
) -> tuple[Certificate, Verdict]:
    """Certificate and verdict of a path: see :func:`judge`."""
    judgement = judge(problem, index, posterior, start_m, positions_m, kkt_residual, drive)
    return judgement.certificate, judgement.verdict


def judge(
    problem: Problem,
    index: ObstacleIndex,
    posterior: ChannelPosterior,
    start_m: NDArray[np.float64],
    positions_m: NDArray[np.float64],
    kkt_residual: float | None = None,
    drive: Drive | None = None,
) -> Judgement:
    """Judge a path (N + 1, 2) of the problem's first robot, which is at `start_m`.

    Parameters
    ----------
    problem, index
        The problem and the index of its obstacles.
    posterior
        What is believed of the channel.
    start_m, positions_m
        Where the robot is (its whole state, where it has more than a place), and the planned path
        from there.
    kkt_residual
        Passed on into the certificate.
    drive
        How the robot drives along the path; None for the single integrator.
    """
    constraints = problem.constraints
    radio = problem.stations[0]
    if not np.isfinite(positions_m).all():
        broken = Certificate(0.0, 0.0, float("inf"), kkt_residual, "exact", reasons=("not finite",))
        return Judgement(broken, Verdict.VIOLATED, None)
    motion = judge_motion(problem, index, start_m, positions_m, drive)
    reasons = list(motion.reasons)

    power, kind = certified_prediction(posterior, positions_m)
    mean, deviation = power.mean_db[1:], power.deviation_db[1:]
    probability = connection_probability(mean, deviation, radio.threshold_dbm)
    # Without a bound every margin is infinite.
    margins = bound_margin_db(mean, deviation, radio.threshold_dbm, constraints.p_min)
    missed = np.nonzero(margins < -MARGIN_TOLERANCE_DB)[0] + 1
    here = bound_margin_db(
        power.mean_db[:1], power.deviation_db[:1], radio.threshold_dbm, constraints.p_min
    )
    best, no_connected_way = _what_is_possible(
        problem, index, posterior, start_m, missed, starts_within=bool(here[0] >= 0.0)
    )
    if not no_connected_way:
        reasons += [
            f"connectivity at step {step} is below constraints.p_min {constraints.p_min:g}, "
            f"although a place with {margin:.2f} dB to spare is within reach"
            + (", and so is a way to the goal that keeps it" if problem.task == "reach" else "")
            for step, margin in zip(missed, best, strict=True)
            if margin >= 0.0
        ][:1]
    if no_connected_way:
        reasons += _needless_outage(problem, index, posterior, positions_m, missed)
    if len(missed) == len(margins):
        reasons.append(
            f"constraints.p_min {constraints.p_min:g} is met at none of the {len(margins)} steps, "
            f"the best place found within reach has a margin of {max(best):.2f} dB"
        )
    certificate = Certificate(
        min_clearance_m=motion.clearance_m,
        min_connectivity=float(probability.min()),
        dynamics_defect=motion.defect_m,
        kkt_residual=kkt_residual,
        posterior=kind,
        relaxed_steps=tuple(int(step) for step in missed),
        relaxation_db=tuple(float(-margins[step - 1]) for step in missed),
        best_margin_db=best,
        no_connected_way=no_connected_way,
        reasons=tuple(reasons),
    )
    verdict = Verdict.VIOLATED if reasons else Verdict.VERIFIED
    return Judgement(certificate, verdict, power, sound=not motion.reasons)


def _what_is_possible(
    problem: Problem,
    index: ObstacleIndex,
    posterior: ChannelPosterior,
    start_m: NDArray[np.float64],
    missed: NDArray[np.intp],
    starts_within: bool,
) -> tuple[tuple[float, ...], bool]:
    """Best margin within reach at each missed step; whether no way to the goal keeps the bound.

    The second is only searched for where there is a goal and some missed step could have been met.
    Ways begin at the
    start if that keeps the bound, else at the places nearest to it that do: those within reach by
    the first step that meets the bound or could.
    """
    constraints, length = problem.constraints, problem.step_length_m
    margin_db = _margins_of(problem, posterior)
    state, start_m = start_m, start_m[:2]
    if missed.size == 0:
        return (), False
    best = best_margins_by_step(
        index,
        problem.workspace.bounds_m,
        margin_db,
        start_m,
        length,
        missed,
        constraints.clearance_m,
        _may_reach(problem, state),
    )
    if best[-1] < 0.0 or problem.task != "reach":
        return best, False
    possible = {int(step) for step, margin in zip(missed, best, strict=True) if margin >= 0.0}
    impossible = set(missed.tolist()) - possible
    first = next(step for step in range(1, int(missed[-1]) + 1) if step not in impossible)
    return best, not connected_way_exists(
        index,
        problem.workspace.bounds_m,
        margin_db,
        start_m,
        np.asarray(problem.goal_m),
        constraints.clearance_m,
        length,
        within_m=0.0 if starts_within else first * length,
    )


def _may_reach(problem: Problem, state: NDArray[np.float64]) -> MayReach | None:
    """Where a robot may be that cannot turn or stop at will; None for any other."""
    dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s
    if dynamics is None:
        return None

    def may_reach(places_m: NDArray[np.float64], step: int, slack_m: float) -> NDArray[np.bool_]:
        return dynamics.may_reach(state, places_m, step * step_s, slack_m)

    return may_reach


def _needless_outage(
    problem: Problem,
    index: ObstacleIndex,
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],
    missed: NDArray[np.intp],
) -> list[str]:
    """Object to missed steps that lead across no gap, where no way to the goal keeps the bound.

    What is driven below the bound must be saved on the least outage of the rest of the way, but
    for the two steps of leeway that the grid and the steps at the gap's edges need.
    """
    here, end = least_outage_m(
        index,
        problem.workspace.bounds_m,
        _margins_of(problem, posterior),
        positions_m[[0, -1]],
        np.asarray(problem.goal_m),
        problem.constraints.clearance_m,
        problem.step_length_m,
    )
    driven = float(np.linalg.norm(np.diff(positions_m, axis=0), axis=1)[missed - 1].sum())
    saved = float(here - end)
    if driven <= saved + OUTAGE_LEEWAY_STEPS * problem.step_length_m:
        return []
    return [
        f"{driven:.1f} m are driven below constraints.p_min {problem.constraints.p_min:g}, which "
        f"shortens what must be driven below it on the way to the goal by {saved:.1f} m"
    ]


def _margins_of(
    problem: Problem, posterior: ChannelPosterior
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Connectivity margin by position, as searches look at it."""

    def margin_db(places: NDArray[np.float64]) -> NDArray[np.float64]:
        power = search_prediction(posterior, places)
        return bound_margin_db(
            power.mean_db,
            power.deviation_db,
            problem.stations[0].threshold_dbm,
            problem.constraints.p_min,
        )

    return margin_db
