"""Bounds of the connectivity rule in a refinement, corrected by the local model's error.

The required margins and sums are corrected by the error at the initial guess, and again at a
returned path that violates the bound.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction
from planopt.planning.programme.path_polish import PathTask, RefinedPath
from planopt.planning.proof.context import SEARCH_ERROR_DB, is_search_exact
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB
from planopt.planning.values.context import StepContext
from planopt.planning.values.local_value import local_value
from planopt.planning.values.rule_rows import RuleRows

LOCAL_PAD_DB = 0.04
"""Margin added to the corrected bound: nine of ten returned paths have a smaller error (48
neighbours, 1,000 measurements, xi 4, beta 20 m)."""

GIVEN_UP_DB = 1e-3
"""Slack up to this value counts as solver tolerance."""

MISSING_DB_COST = 100.0
"""Cost per dB of slack in the solver if the bound cannot be met."""


def with_bounds(task: PathTask, context: StepContext, rows: RuleRows) -> PathTask:
    """Return the task with bounds that the guess meets; elsewhere with the least shortfall.

    The initial guess stays feasible. Bounded slack is available to all steps at its price.
    """
    if rows.weight is not None:
        return _with_total(task, context, rows)
    if not context.problem.constraints.asks_connection:
        return task
    wanted, local, exact = _wanted(task, context, rows)
    kept = exact >= -MARGIN_TOLERANCE_DB
    bound = np.where(kept, np.minimum(wanted, local), wanted)
    limit, weight = _slack(context, task.scale, np.where(np.isfinite(exact), -exact, 0.0))
    if not context.problem.constraints.rule.by_step:
        weight = weight if np.isinf(limit).any() else weight / max(int(rows.asked.sum()), 1)
    return replace(
        task,
        bound_db=np.where(rows.asked, bound, -np.inf),
        slack_limit_db=np.where(rows.asked, limit, 0.0),
        slack_weight=weight,
    )


def lacks(
    context: StepContext, rows: RuleRows, point: RefinedPath, *, firmly: bool = False
) -> bool:
    """Return whether a returned path violates a bound that it meets by the local model.

    With `firmly` a margin below the error of the search's predictions counts as a violation, since
    its verification may be expensive.
    """
    if not len(point.slack_db) or not np.isfinite(point.path_m).all():
        return False
    power = context.power(point.path_m)
    if rows.weight is not None:
        missing = _slack_of_sum(rows, power) > MARGIN_TOLERANCE_DB
        return bool(point.slack_db[0] <= GIVEN_UP_DB and missing)
    margins = rows.margins_db(power)
    unsure = firmly and not is_search_exact(context.posterior)
    least = SEARCH_ERROR_DB if unsure else -MARGIN_TOLERANCE_DB
    return bool((margins[point.slack_db <= GIVEN_UP_DB] < least).any())


def recentred(task: PathTask, context: StepContext, rows: RuleRows, point: RefinedPath) -> PathTask:
    """Return the task corrected by the local model's error at a returned path."""
    task = moved(task, context, rows, point.path_m)
    if rows.weight is not None:
        return replace(task, total_bound=_wanted_total(task, context, rows)[0])
    wanted = _wanted(task, context, rows)[0]
    return replace(task, bound_db=np.where(rows.asked, wanted, -np.inf))


def moved(
    task: PathTask, context: StepContext, rows: RuleRows, path_m: NDArray[np.float64]
) -> PathTask:
    """Return the task for another path (N, 2), with the local channel near it."""
    return replace(task, path_m=path_m, evaluate=local_value(context, path_m, rows))


def _with_total(task: PathTask, context: StepContext, rows: RuleRows) -> PathTask:
    power = context.power(task.path_m)
    task = replace(task, total_per_db=_per_db(rows, power))
    wanted, local = _wanted_total(task, context, rows)
    short_db = (rows.total - rows.sum_of(power)) / task.total_per_db
    limit, weight = _slack(context, task.scale, np.array([short_db]))
    return replace(
        task,
        total_bound=wanted if short_db > 0.0 else min(wanted, local),
        slack_limit_db=limit,
        slack_weight=weight,
    )


def _slack(
    context: StepContext, scale: float, missing_db: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Return the limit of each row's slack, and the slack's cost per dB in the solver.

    The limit is infinite for rows that the guess violates beyond the slack; slack then costs more.
    """
    rule = context.problem.constraints.rule
    allowed = rule.slack_max_db or 0.0
    limit = np.where(missing_db <= allowed + MARGIN_TOLERANCE_DB, allowed, np.inf)
    if np.isinf(limit).any() or allowed == 0.0:
        return limit, MISSING_DB_COST
    return limit, scale * rule.slack_price


def _wanted(
    task: PathTask, context: StepContext, rows: RuleRows
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the required local margins, and the guess's local and exact margins.

    The requirement includes the local model's error at the guess.
    """
    margins = task.evaluate(task.path_m).margins
    if margins is None:
        raise AssertionError("a bounded problem has margins")
    exact = rows.margins_db(context.power(task.path_m))
    return LOCAL_PAD_DB + margins.value - exact, margins.value, exact


def _wanted_total(task: PathTask, context: StepContext, rows: RuleRows) -> tuple[float, float]:
    """Return the required local sum, and the guess's local sum."""
    total = task.evaluate(task.path_m).total
    if total is None:
        raise AssertionError("a bounded sum is there")
    off = total.value - rows.sum_of(context.power(task.path_m))
    return rows.total + off + LOCAL_PAD_DB * task.total_per_db, total.value


def _per_db(rows: RuleRows, power: Prediction) -> float:
    """Return the derivative of the sum by the threshold reduction in dB; not zero."""
    if rows.weight is None:
        raise AssertionError("no sum is bounded")
    score = (power.mean_db - rows.threshold_dbm) / power.deviation_db
    density = np.exp(-0.5 * score**2) / (np.sqrt(2.0 * np.pi) * power.deviation_db)
    return max(float(rows.weight @ density), 1e-3 * float(rows.weight.max(initial=0.0)), 1e-9)


def _slack_of_sum(rows: RuleRows, power: Prediction) -> float:
    """Return the shortfall of the sum in dB, to first order."""
    return (rows.total - rows.sum_of(power)) / _per_db(rows, power)
