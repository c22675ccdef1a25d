"""Scores of planners, computed from the rows of the regression suite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Rung, Termination, Verdict
from planopt.studies.bench.cases import ERROR, NO_PLAN, Question, Row
from planopt.studies.bench.references import OBJECTIVE_SHARE, worse_share

SHIFT_S = 0.01
"""Shift of the geometric mean of times; differences far below it are negligible."""

LIMIT_S = 10.0
"""Time in seconds per step that is assigned to unsolved cases."""

CONVERGED = (Termination.CONVERGED.value, Termination.ACCEPTABLE.value)
"""Solver terminations that claim an optimum."""


@dataclass(frozen=True)
class Score:
    """Scores of one planner."""

    planner: str
    cases: int
    success_rate: float  # Share of solved cases (:func:`is_solved`)
    # Share of correct claims (:func:`claims`, :func:`is_wrong`); None if the planner claims nothing
    correct_rate: float | None
    verified_rate: float  # Share of cases with the verdict verified
    rejected: int  # Number of verified plans that the check rejects
    errors: int  # Number of cases that ended with an error
    fallback_share: float  # Share of released plans from a fallback other than plan
    # Relative excess of objectives over the best known; None if none is known
    median_excess: float | None
    largest_excess: float | None
    iterations: float  # Mean number of solver iterations per plan
    # Shifted geometric mean and median of the CPU time per plan, in seconds; unsolved cases count
    # as `LIMIT_S` in the mean and are excluded from the median
    mean_s: float
    median_s: float | None


def excess(row: Row, best: Mapping[Question, float]) -> float | None:
    """Return the relative excess of a row's objective over the best known; None if unknown."""
    known = best.get(row.question)
    if known is None or row.objective is None:
        return None
    return worse_share(row.objective, known, row.sense)


def is_solved(row: Row, best: Mapping[Question, float]) -> bool:
    """Return whether an answer is verified, accepted and near the best known objective.

    The answer "no plan" is correct if no plan is known.
    """
    if row.outcome == NO_PLAN:
        return row.question not in best
    if row.verdict != Verdict.VERIFIED.value or row.accepted is False or row.outcome == ERROR:
        return False
    worse = excess(row, best)
    return worse is None or worse <= OBJECTIVE_SHARE


def claims(row: Row) -> bool:
    """Return whether a planner claims a verified plan, an optimum, or that no plan exists."""
    verified = row.verdict == Verdict.VERIFIED.value
    return verified or row.termination in CONVERGED or row.outcome == NO_PLAN


def is_wrong(row: Row, best: Mapping[Question, float]) -> bool:
    """Return whether a claim is false: rejected, far from the best, or no plan where one exists."""
    if row.outcome == NO_PLAN:
        return row.question in best
    if row.verdict == Verdict.VERIFIED.value and row.accepted is False:
        return True
    worse = excess(row, best)
    return row.termination in CONVERGED and worse is not None and worse > OBJECTIVE_SHARE


def scores(rows: Sequence[Row], best: Mapping[Question, float]) -> list[Score]:
    """Return the score of every planner, in order of first occurrence."""
    planners = dict.fromkeys(row.planner for row in rows)
    return [_score(name, [row for row in rows if row.planner == name], best) for name in planners]


def _score(planner: str, rows: Sequence[Row], best: Mapping[Question, float]) -> Score:
    solved = np.array([is_solved(row, best) for row in rows])
    claimed = [row for row in rows if claims(row)]
    wrong = sum(is_wrong(row, best) for row in claimed)
    verified = [row for row in rows if row.verdict == Verdict.VERIFIED.value]
    worse = [share for share in (excess(row, best) for row in rows) if share is not None]
    steps = sum(row.steps for row in rows)
    direct = sum(row.rungs.get(Rung.PLAN.value, 0) for row in rows)
    times_s = np.array([step_s(row) for row in rows])
    return Score(
        planner=planner,
        cases=len(rows),
        success_rate=float(solved.mean()),
        correct_rate=1.0 - wrong / len(claimed) if claimed else None,
        verified_rate=len(verified) / len(rows),
        rejected=sum(row.accepted is False for row in verified),
        errors=sum(row.outcome == ERROR for row in rows),
        fallback_share=1.0 - direct / steps if steps else 0.0,
        median_excess=float(np.median(worse)) if worse else None,
        largest_excess=max(worse, default=None),
        iterations=sum(row.iterations for row in rows) / steps if steps else 0.0,
        mean_s=shifted_geometric_mean(np.where(solved, times_s, LIMIT_S), SHIFT_S),
        median_s=float(np.median(times_s[solved])) if solved.any() else None,
    )


def step_s(row: Row) -> float:
    """Return the CPU time of a row per plan, in seconds."""
    return row.cpu_s / max(row.steps, 1)


def shifted_geometric_mean(times_s: NDArray[np.float64], shift_s: float) -> float:
    """Return exp(mean(log(t + s))) - s in seconds, which is insensitive to very short times."""
    return float(np.exp(np.log(np.asarray(times_s) + shift_s).mean()) - shift_s)


@dataclass(frozen=True, eq=False)
class Profile:
    """Performance profile (Dolan and More, 2002)."""

    planners: tuple[str, ...]  # Names of the planners
    ratios: NDArray[np.float64]  # (k,) sorted ratios to the best time of a question, at least 1
    # (planners, k) share of questions solved by each planner within each ratio
    shares: NDArray[np.float64]


def time_profile(rows: Sequence[Row], best: Mapping[Question, float]) -> Profile:
    """Return the profile of the times of solved cases over the questions."""
    planners = tuple(dict.fromkeys(row.planner for row in rows))
    questions = {question: n for n, question in enumerate(dict.fromkeys(r.question for r in rows))}
    times_s = np.full((len(questions), len(planners)), np.nan)
    for row in rows:
        solved = is_solved(row, best)
        at = questions[row.question], planners.index(row.planner)
        times_s[at] = step_s(row) if solved else np.inf
    ratios, shares = performance_profile(times_s)
    return Profile(planners, ratios, shares)


def performance_profile(
    times_s: NDArray[np.float64],  # (q, s)
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ratios (k,) and the share of questions solved by each solver within them (s, k)."""
    finite = np.where(np.isfinite(times_s), times_s, np.inf)
    fastest = finite.min(axis=1, keepdims=True) if finite.size else finite[:, :1]
    some = np.isfinite(fastest)
    # A zero time is the fastest; equal times have the ratio 1.
    least = np.where(some, np.maximum(fastest, np.finfo(float).tiny), 1.0)
    ratio = np.where(np.isfinite(finite), np.maximum(finite, least) / least, np.inf)
    ratios = np.unique(np.append(ratio[np.isfinite(ratio)], 1.0))
    asked = ~np.isnan(times_s)
    within = (ratio[:, :, None] <= ratios) & asked[:, :, None]
    counts = np.maximum(asked.sum(axis=0), 1)
    return ratios, within.sum(axis=0) / counts[:, None]
