"""Best position within one step, proven by branch and bound over squares."""

from dataclasses import dataclass
from functools import partial
from time import monotonic

import numpy as np
import shapely

from planopt.arrays import Floats
from planopt.bounds.multipliers import local_optimum, tilts_near
from planopt.bounds.tube import (
    FIRST_SHARE,
    MARGIN,
    MOST_LEVELS,
    ONE_STEP_GAP,
    StageProblem,
    evaluated,
    first_cells,
    kept_cells,
    through_bounds,
)
from planopt.objectives.upper_bounds import Discs, Field, Makers, constant_bounds

STARTS = 3  # Number of cells per level whose centres are evaluated
LEAST_VALUE = 0.02
"""Relative gap at which a position counts as optimal, and the minimum of its denominator."""


@dataclass(frozen=True, eq=False)
class BestPlace:
    """Best known position of a one-step problem, with a proven bound."""

    place_m: Floats  # (2,)
    value: float
    bound: float
    seconds: float

    @property
    def gap(self) -> float:
        """Return the relative gap between value and bound."""
        return (self.bound - self.value) / max(abs(self.value), LEAST_VALUE)


def best_place(problem: StageProblem, seconds: float) -> BestPlace:
    """Return the best position within one step, and an upper bound proven in about `seconds`."""
    begun, bound, levels = monotonic(), np.inf, 0
    place, value = problem.start_m, -np.inf
    near = problem.sure_m[np.hypot(*(problem.sure_m - problem.start_m).T) <= problem.step_m]
    if len(near):
        makers: Makers = {**problem.makers, "chance": partial(constant_bounds, value=1.0)}
        place, value = best_of(problem, near, makers)
    tilts = list[Floats]()
    side, active = FIRST_SHARE * problem.step_m, first_cells(problem)
    while len(active[0]) and levels < MOST_LEVELS:
        levels += 1
        level = evaluated(problem, side, active)
        highest = np.argsort(-level.rewards[0].value)[:STARTS]
        centres = problem.start_m + level.offsets_m(0)[highest]
        found, reached = best_of(problem, centres, problem.makers)
        if reached > value or levels == 1:
            begins = found if np.isfinite(reached) else problem.start_m
            both = np.vstack([local_optimum(problem, begins[None]), begins])
            found, reached = best_of(problem, both, problem.makers)
        if reached > value:
            place, value = found, reached
            tilts = tilts_near(problem, [place[None]], np.zeros((0, 2)))
        through = through_bounds(level, tilts)
        threshold = value + 0.5 * ONE_STEP_GAP * max(abs(value), LEAST_VALUE)
        bound = min(bound, max(threshold, float(through[0].max(initial=-np.inf))))
        if bound <= threshold or monotonic() - begun > seconds:
            break
        active, side = kept_cells(level, through, threshold), 0.5 * side
    bound += MARGIN * abs(bound)
    return BestPlace(place, value, bound, monotonic() - begun)


def best_of(problem: StageProblem, places_m: Floats, makers: Makers) -> tuple[Floats, float]:
    """Return the best position and its value after moving positions (n, 2) within reach."""
    moves = places_m - problem.start_m
    longest = np.maximum(np.hypot(*moves.T), problem.step_m)
    places = problem.start_m + moves * (problem.step_m / longest)[:, None]
    x0, y0, x1, y1 = problem.limits_m[0]
    places = np.clip(places, [x0, y0], [x1, y1])
    field = Field(Discs(places, 0.0), makers)
    values = problem.reward(0, field).value.copy()
    length = np.hypot(*(places - problem.start_m).T)
    values -= problem.per_metre * length
    values -= np.where(length > problem.standstill_m, problem.per_move, 0.0)
    for area in problem.blocked:
        values[shapely.contains_xy(area, *places.T)] = -np.inf
    if problem.p_min is not None:
        values[field["chance"].value < problem.p_min[0]] = -np.inf
    best = int(values.argmax())
    return places[best], float(values[best])
