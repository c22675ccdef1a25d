"""How a search over a lattice minds the rule of connectivity: bounds on steps, credit for chances.

Dynamic programming adds rewards up. A rule over all steps is no such sum, so that it is searched
for by several guides, each with bounds or credits of its own, whose paths are judged by the rule.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.planning.proof.rules.asked import asked_steps, data_asked_mbit
from planopt.planning.worth.held_steps import ROUNDING, fewest_held
from planopt.planning.worth.situation import Situation

HIGHEST_CREDIT, LOWEST_CREDIT = 10.0, 1e-3
"""Credit of a connected step, in units of the largest reward of a step: with the first no other
reward counts, with the second hardly the credit."""

HALVINGS = 5
"""Bisections of the credit between them, in its logarithm."""

PATTERNS = 4
"""In so many ways the steps that end an outage are chosen."""


@dataclass(frozen=True, eq=False)
class Guide:
    """What a search minds.

    Attributes
    ----------
    level
        Probability that the steps asked for must keep.
    asked
        ``(N,)`` which these are.
    credit
        ``(N,)`` what a connection is worth at each step, in units of the largest reward of a step;
        its chance counts.
    """

    level: float
    asked: NDArray[np.bool_]
    credit: NDArray[np.float64]


def find_guided(
    situation: Situation,
    search: Callable[[Guide], list[NDArray[np.float64]]],
    is_kept: Callable[[NDArray[np.float64]], bool],
) -> list[NDArray[np.float64]]:
    """Paths (N, 2) of a search under the guides that suit the rule.

    Parameters
    ----------
    situation
        What is known.
    search
        From a guide to the best paths, best first.
    is_kept
        Whether a path keeps the rule.
    """
    if situation.problem.constraints.rule.connectivity in ("average", "data"):
        return _by_credit(situation, search, is_kept)
    return [path for guide in _by_steps(situation) for path in search(guide)]


def _by_steps(situation: Situation) -> list[Guide]:
    """Guides that bound single steps."""
    problem, history = situation.problem, situation.circumstances.history
    constraints, count = problem.constraints, problem.planner.horizon
    p_min, no_credit = constraints.p_min, np.zeros(count)
    every = np.ones(count, dtype=bool)
    match constraints.rule.connectivity:
        case "joint":
            # Independent outages would need the first, one and the same outage the second.
            return [Guide(level, every, no_credit) for level in (p_min ** (1.0 / count), p_min)]
        case "outage":
            rule = constraints.rule
            if rule.outage_max_m is not None:
                sizes, before = np.full(count, problem.step_length_m), history.outage_m
            else:
                sizes = np.full(count, problem.planner.step_s)
                before = history.outage_steps * problem.planner.step_s
            limit = rule.outage_max_m if rule.outage_max_m is not None else rule.outage_max_s
            patterns = _patterns(sizes, (limit or 0.0) * (1.0 + ROUNDING), before)
            return [Guide(p_min, asked, no_credit) for asked in (*patterns, every)]
        case _:
            asked = asked_steps(problem, history, count) & constraints.asks_connection
            return [Guide(p_min, asked, no_credit)]


def _patterns(sizes: NDArray[np.float64], limit: float, before: float) -> list[NDArray[np.bool_]]:
    """Steps that are held so that no run of others is too long; the first as late as may be.

    In the others it is held earlier, up to `PATTERNS` evenly, and those after it with it.
    """
    latest = fewest_held(sizes, np.ones(len(sizes), dtype=bool), limit, before)
    last = int(np.argmax(latest)) if latest.any() else 0
    patterns = [latest]
    for first in np.unique(np.linspace(0, last, PATTERNS).astype(np.intp))[:-1].tolist():
        held = np.zeros(len(sizes), dtype=bool)
        held[first] = True
        rest = sizes[first + 1 :]
        held[first + 1 :] = fewest_held(rest, np.ones(len(rest), dtype=bool), limit, 0.0)
        patterns.append(held)
    return patterns


def _by_credit(
    situation: Situation,
    search: Callable[[Guide], list[NDArray[np.float64]]],
    is_kept: Callable[[NDArray[np.float64]], bool],
) -> list[NDArray[np.float64]]:
    """Paths under a credit that is as small as it may be: a Lagrange multiplier, by bisection."""
    problem, count = situation.problem, situation.problem.planner.horizon
    weight = np.ones(count)
    if problem.constraints.rule.connectivity == "data":
        weight, _ = data_asked_mbit(problem, situation.circumstances.history, count)
        weight = weight / max(float(weight.max()), 1e-9)
    none = Guide(0.0, np.zeros(count, dtype=bool), np.zeros(count))
    found = search(none)
    if not found or is_kept(found[0]):
        return found
    low, high = LOWEST_CREDIT, HIGHEST_CREDIT
    most = search(replace(none, credit=high * weight))
    found += most
    if not most or not is_kept(most[0]):
        return found
    for _ in range(HALVINGS):
        middle = float(np.sqrt(low * high))
        paths = search(replace(none, credit=middle * weight))
        found += paths
        low, high = (low, middle) if paths and is_kept(paths[0]) else (middle, high)
    return found
