"""Why a plan misses the bound on connectivity, and what would let it be kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from planopt.channel.connectivity import bound_quantile, connection_probability
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.explain.explanation import Relaxation, towards
from planopt.planning.explain.no_way import DIGITS, SolveAgain
from planopt.planning.explain.reach_limits import best_margin_db, best_probability, least_horizon
from planopt.planning.plan import Plan, Verdict
from planopt.problems.problem import Problem
from planopt.problems.settings import MAX_HORIZON

PADS_DB = (0.005, 0.03, 0.1, 0.3, 1.0, 3.0)
"""What a planner may need beyond the limit, tried in turn."""

PADS_QUANTILE = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
"""The same in standard deviations."""

LEAST_P_MIN = 0.01
"""A smaller probability is no answer to who wants to be connected."""

SETTLED_SHARE = 0.02
"""The least value that helps is looked for to this share of the relaxation."""

LONGER = (0, 1, 2, 4, 8, 16)
"""Steps beyond the fewest that come to a place by air, which may not do round obstacles."""


def explain_no_connection(
    problem: Problem, posteriors: Sequence[ChannelPosterior], plan: Plan, solve_again: SolveAgain
) -> tuple[Relaxation, ...]:
    """What would let the bound be kept, each change by itself; nothing where it is not missed.

    Parameters
    ----------
    problem
        With the plan's robot alone.
    posteriors
        What the plan was made from, of each station.
    plan
        One that is not verified.
    solve_again
        Judges the changed problems.
    """
    missed = plan.certificate.relaxed_steps
    if not missed:
        return ()
    start = plan.positions_m[0]
    nowhere = len(missed) == len(plan.positions_m) - 1
    if nowhere:
        # The limit of what any plan could keep.
        limit = best_probability(problem, posteriors, start)
        short_db = max(-best_margin_db(problem, posteriors, start), 0.0)
    else:
        # The limit of what this plan keeps where it is blamed.
        limit = float(plan.connectivity[list(missed)].min())
        short_db = max(plan.certificate.relaxation_db)
    found = [
        _probability(problem, plan, limit, short_db, solve_again),
        _threshold(problem, plan, short_db, solve_again),
    ]
    if nowhere:
        found.append(_horizon(problem, posteriors, plan, short_db, solve_again))
    return tuple(relaxation for relaxation in found if relaxation is not None)


def _probability(
    problem: Problem, plan: Plan, limit: float, short_db: float, solve_again: SolveAgain
) -> Relaxation | None:
    z, asked = bound_quantile(limit), problem.constraints.p_min
    if not np.isfinite(z):
        return None
    pads = z - np.array(PADS_QUANTILE)
    tried = connection_probability(pads, np.ones(len(pads)), 0.0)
    values = [p for p in tried.tolist() if LEAST_P_MIN <= towards(p, DIGITS, down=True) < asked]

    def changed(p_min: float) -> Problem:
        return replace(problem, constraints=replace(problem.constraints, p_min=p_min))

    about = Relaxation(
        "constraints.p_min", "", asked, _stages(plan), short_db, "dB", asked, False, plan.robot
    )
    return _nearest(about, values, changed, solve_again)


def _threshold(
    problem: Problem, plan: Plan, short_db: float, solve_again: SolveAgain
) -> Relaxation | None:
    radio, *others = problem.stations
    if others:
        return None  # what is missing is of all thresholds, and each is a key of its own
    asked = radio.threshold_dbm
    values = [asked - short_db - pad for pad in PADS_DB]

    def changed(threshold_dbm: float) -> Problem:
        return replace(problem, stations=(replace(radio, threshold_dbm=threshold_dbm),))

    about = Relaxation(
        "stations[0].threshold_dbm",
        "dBm",
        asked,
        _stages(plan),
        short_db,
        "dB",
        asked,
        False,
        plan.robot,
    )
    return _nearest(about, values, changed, solve_again)


def _horizon(
    problem: Problem,
    posteriors: Sequence[ChannelPosterior],
    plan: Plan,
    short_db: float,
    solve_again: SolveAgain,
) -> Relaxation | None:
    fewest, asked = least_horizon(problem, posteriors, plan.positions_m[0]), problem.planner.horizon
    if fewest is None:
        return None
    about = Relaxation(
        "planner.horizon", "", asked, _stages(plan), short_db, "dB", fewest, False, plan.robot
    )
    for more in LONGER:
        steps = min(fewest + more, MAX_HORIZON)
        changed = replace(problem, planner=replace(problem.planner, horizon=steps))
        if solve_again(changed) is Verdict.VERIFIED:
            return replace(about, relaxed_value=steps, verified=True)
    return about


def _stages(plan: Plan) -> tuple[int, ...]:
    return plan.certificate.relaxed_steps


def _nearest(
    about: Relaxation,
    values: Sequence[float],
    changed: Callable[[float], Problem],
    solve_again: SolveAgain,
) -> Relaxation | None:
    """The value nearest to what is asked that helps; unverified the first, where none does.

    Values decrease; between the last that does not help and the first that does is halved.
    """
    if not values or about.value is None:
        return None

    def helps(value: float) -> bool:
        return solve_again(changed(value)) is Verdict.VERIFIED

    typed = [towards(value, DIGITS, down=True) for value in values]
    first = next((number for number, value in enumerate(typed) if helps(value)), None)
    if first is None:
        return replace(about, relaxed_value=typed[0])
    low = typed[first]
    high = typed[first - 1] if first else low
    while high - low > SETTLED_SHARE * (about.value - low):
        middle = towards(0.5 * (low + high), DIGITS, down=True)
        if not low < middle < high:
            break
        low, high = (middle, high) if helps(middle) else (low, middle)
    return replace(about, relaxed_value=low, verified=True)
