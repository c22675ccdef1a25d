"""Why a plan misses the bound on connectivity, and what would let it be kept."""

from __future__ import annotations

from collections.abc import Iterable
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

PADS_DB = (0.03, 0.1, 0.3, 1.0, 3.0)
"""What a planner may need beyond the limit, tried in turn; the first that helps is proposed."""

PADS_QUANTILE = (0.003, 0.01, 0.03, 0.1, 0.3)
"""The same in standard deviations."""

LONGER = (0, 1, 2, 4, 8, 16)
"""Steps beyond the fewest that come to a place by air, which may not do round obstacles."""


def explain_no_connection(
    problem: Problem, posterior: ChannelPosterior, plan: Plan, solve_again: SolveAgain
) -> tuple[Relaxation, ...]:
    """What would let the bound be kept, each change by itself; nothing where it is not missed.

    Parameters
    ----------
    problem
        With the plan's robot alone.
    posterior
        What the plan was made from.
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
        limit = best_probability(problem, posterior, start)
        short_db = max(-best_margin_db(problem, posterior, start), 0.0)
    else:
        # The limit of what this plan keeps where it is blamed.
        limit = float(plan.connectivity[list(missed)].min())
        short_db = max(plan.certificate.relaxation_db)
    found = [
        _probability(problem, plan, limit, short_db, solve_again),
        _threshold(problem, plan, short_db, solve_again),
    ]
    if nowhere:
        found.append(_horizon(problem, posterior, plan, short_db, solve_again))
    return tuple(relaxation for relaxation in found if relaxation is not None)


def _probability(
    problem: Problem, plan: Plan, limit: float, short_db: float, solve_again: SolveAgain
) -> Relaxation | None:
    z = bound_quantile(limit)
    if not np.isfinite(z):
        return None
    pads = z - np.array(PADS_QUANTILE)
    tried = connection_probability(pads, np.ones(len(pads)), 0.0)
    values = [towards(float(p), DIGITS, down=True) for p in tried]
    values = [p for p in values if 0.0 < p < problem.constraints.p_min]
    changed = (
        (p, replace(problem, constraints=replace(problem.constraints, p_min=p))) for p in values
    )
    return _first(
        "constraints.p_min", "", problem.constraints.p_min, plan, short_db, changed, solve_again
    )


def _threshold(
    problem: Problem, plan: Plan, short_db: float, solve_again: SolveAgain
) -> Relaxation | None:
    radio = problem.stations[0]
    values = [
        towards(radio.threshold_dbm - short_db - pad, DIGITS + 1, down=True) for pad in PADS_DB
    ]
    changed = ((t, replace(problem, stations=(replace(radio, threshold_dbm=t),))) for t in values)
    key = "stations[0].threshold_dbm"
    return _first(key, "dBm", radio.threshold_dbm, plan, short_db, changed, solve_again)


def _horizon(
    problem: Problem,
    posterior: ChannelPosterior,
    plan: Plan,
    short_db: float,
    solve_again: SolveAgain,
) -> Relaxation | None:
    fewest = least_horizon(problem, posterior, plan.positions_m[0])
    if fewest is None:
        return None
    values = [min(fewest + more, MAX_HORIZON) for more in LONGER]
    changed = ((n, replace(problem, planner=replace(problem.planner, horizon=n))) for n in values)
    asked = problem.planner.horizon
    return _first("planner.horizon", "", asked, plan, short_db, changed, solve_again)


def _first(
    key: str,
    unit: str,
    asked: float,
    plan: Plan,
    short_db: float,
    changed: Iterable[tuple[float, Problem]],
    solve_again: SolveAgain,
) -> Relaxation | None:
    """The first value that helps; the first of all, unverified, where none does."""
    first: Relaxation | None = None
    for value, problem in changed:
        verified = solve_again(problem) is Verdict.VERIFIED
        relaxation = Relaxation(
            key,
            unit,
            asked,
            plan.certificate.relaxed_steps,
            short_db,
            "dB",
            value,
            verified,
            plan.robot,
        )
        if verified:
            return relaxation
        first = first or relaxation
    return first
