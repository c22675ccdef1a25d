"""The bound on single steps: where it is missed, whether it could be met, and what that means.

A step may miss the bound for one of two reasons. No place within reach meets it by then; or no way
to the goal keeps it at all and the steps below it lead across a gap by about the least length there
is. Both are proven, not assumed. Where slack is bounded it is the only excuse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import bound_margin_db
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.planning.history import History
from planopt.planning.proof.broad_prediction import Broad
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.proof.reach_of_dynamics import may_reach_from
from planopt.planning.proof.reachability import best_margins_by_step
from planopt.planning.proof.rules.asked import asked_steps
from planopt.planning.proof.ways_to_goal import connected_way_exists, least_outage_m
from planopt.planning.rule_result import RuleResult
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex

MarginAt = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""From positions (n, 2) to margins (n,) in dB."""

OUTAGE_LEEWAY_STEPS = 2.0
"""How much longer, in longest steps, a way through a gap may be than the least one."""


@dataclass(frozen=True)
class StepsFinding:
    """What is found of the bound on single steps; fields as in the certificate.

    Attributes
    ----------
    relaxed_steps, relaxation_db, best_margin_db, no_connected_way, reasons
        As in :class:`planopt.planning.certificate.Certificate`.
    result
        None for the plain rule: at each step where possible.
    """

    relaxed_steps: tuple[int, ...]
    relaxation_db: tuple[float, ...]
    best_margin_db: tuple[float, ...]
    no_connected_way: bool
    reasons: tuple[str, ...]
    result: RuleResult | None


def judge_single_steps(
    problem: Problem,
    history: History,
    index: ObstacleIndex,
    posterior: ChannelPosterior,
    state: NDArray[np.float64],
    positions_m: NDArray[np.float64],
    power: Prediction,
    broad: Broad | None = None,
) -> StepsFinding:
    """Judge the bound at the steps of a path (N + 1, 2) that it is asked of.

    Parameters
    ----------
    problem, history
        What is asked, and what has happened.
    index
        Of its obstacles.
    posterior
        What is believed of the channel.
    state
        ``(s,)`` the robot's state, its place first.
    positions_m, power
        The path and the prediction along it, its first place included.
    broad
        What the bound rests on where it is not the posterior alone.
    """
    constraints, radio = problem.constraints, problem.stations[0]
    mean, deviation = power.mean_db[1:], power.deviation_db[1:]
    # Without a bound every margin is infinite.
    margins = bound_margin_db(mean, deviation, radio.threshold_dbm, constraints.p_min)
    asked = asked_steps(problem, history, len(margins))
    missed = np.nonzero((margins < -MARGIN_TOLERANCE_DB) & asked)[0] + 1
    relaxation = tuple(float(-margins[step - 1]) for step in missed)
    result = _result(problem, asked, relaxation)
    if constraints.rule.slack_max_db is not None:
        reasons = _beyond_slack(problem, missed, relaxation)
        return StepsFinding(tuple(missed.tolist()), relaxation, (), False, tuple(reasons), result)
    here = bound_margin_db(
        power.mean_db[:1], power.deviation_db[:1], radio.threshold_dbm, constraints.p_min
    )
    margin_db = _margins_of(problem, posterior, broad)
    best, no_connected_way = _what_is_possible(
        problem,
        index,
        margin_db,
        state,
        missed,
        starts_within=bool(here[0] >= 0.0),
    )
    reasons: list[str] = []
    if not no_connected_way:
        reasons += [
            f"connectivity at step {step} is below constraints.p_min {constraints.p_min:g}, "
            f"although a place with {margin:.2f} dB to spare is within reach"
            + (", and so is a way to the goal that keeps it" if problem.task == "reach" else "")
            for step, margin in zip(missed, best, strict=True)
            if margin >= 0.0
        ][:1]
    if no_connected_way:
        avoidable = missed[np.asarray(best) >= 0.0]
        reasons += _needless_outage(problem, index, margin_db, positions_m, avoidable)
    count = int(asked.sum())
    if len(missed) == count and count:
        reasons.append(
            f"constraints.p_min {constraints.p_min:g} is met at none of the {count} steps"
            f"{'' if count == len(margins) else ' that it is asked of'}, "
            f"the best place found within reach has a margin of {max(best):.2f} dB"
        )
    return StepsFinding(
        tuple(missed.tolist()), relaxation, best, no_connected_way, tuple(reasons), result
    )


def _result(
    problem: Problem,
    asked: NDArray[np.bool_],
    relaxation_db: tuple[float, ...],
) -> RuleResult | None:
    """How many of the steps that are asked for keep the bound; None for the plain rule."""
    rule = problem.constraints.rule
    if rule.connectivity == "each_step" and rule.slack_max_db is None:
        return None
    kept = int(asked.sum()) - len(relaxation_db)
    return RuleResult(
        rule.connectivity,
        float(kept),
        float(asked.sum()),
        "steps",
        "p_min at each step asked for",
        # What is missed where nothing keeps the bound is not slack, which was not allowed.
        0.0 if rule.slack_max_db is None else max(relaxation_db, default=0.0),
    )


def _beyond_slack(
    problem: Problem, missed: NDArray[np.intp], relaxation_db: tuple[float, ...]
) -> list[str]:
    """Object to steps that miss the bound by more than the slack."""
    limit = problem.constraints.rule.slack_max_db or 0.0
    return [
        f"connectivity at step {step} misses constraints.p_min {problem.constraints.p_min:g} by "
        f"{missing:.4g} dB, constraints.slack_max_db is {limit:g}"
        for step, missing in zip(missed.tolist(), relaxation_db, strict=True)
        if missing > limit + MARGIN_TOLERANCE_DB
    ]


def _what_is_possible(
    problem: Problem,
    index: ObstacleIndex,
    margin_db: MarginAt,
    state: NDArray[np.float64],
    missed: NDArray[np.intp],
    starts_within: bool,
) -> tuple[tuple[float, ...], bool]:
    """Best margin within reach at each missed step; whether no way to the goal keeps the bound.

    The second is only searched for where there is a goal and some missed step could have been met.
    Ways begin at the start if that keeps the bound, else at
    the places nearest to it that do: those within reach by the first step that meets the bound or
    could.
    """
    constraints, length = problem.constraints, problem.step_length_m
    start_m = state[:2]
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
        may_reach_from(problem, state),
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


def _needless_outage(
    problem: Problem,
    index: ObstacleIndex,
    margin_db: MarginAt,
    positions_m: NDArray[np.float64],
    missed: NDArray[np.intp],
) -> list[str]:
    """Object to missed steps that lead across no gap, where no way to the goal keeps the bound.

    Only steps count at which the bound could be met. What is driven below it in them must be saved
    in them on the least outage of the rest of the way, but for the two steps of leeway that the
    grid and the steps at the gap's edges need.
    """
    outage = least_outage_m(
        index,
        problem.workspace.bounds_m,
        margin_db,
        positions_m,
        np.asarray(problem.goal_m),
        problem.constraints.clearance_m,
        problem.step_length_m,
    )
    driven = float(np.linalg.norm(np.diff(positions_m, axis=0), axis=1)[missed - 1].sum())
    saved = float((outage[missed - 1] - outage[missed]).sum())
    if driven <= saved + OUTAGE_LEEWAY_STEPS * problem.step_length_m:
        return []
    changes = "shortens" if saved >= 0.0 else "lengthens"
    return [
        f"{driven:.1f} m are driven below constraints.p_min {problem.constraints.p_min:g}, which "
        f"{changes} what must be driven below it on the way to the goal by {abs(saved):.1f} m"
    ]


def _margins_of(problem: Problem, posterior: ChannelPosterior, broad: Broad | None) -> MarginAt:
    """Connectivity margin by position, as searches look at it."""

    def margin_db(places: NDArray[np.float64]) -> NDArray[np.float64]:
        power = search_prediction(posterior, places, broad)
        return bound_margin_db(
            power.mean_db,
            power.deviation_db,
            problem.stations[0].threshold_dbm,
            problem.constraints.p_min,
        )

    return margin_db
