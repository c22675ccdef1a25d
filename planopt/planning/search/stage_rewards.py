"""What it is worth to end a step at a node: exact for terms that add up, a stand-in for others.

Terms that couple the places of a path cannot be searched by dynamic programming. In their place
stands what a place would be worth alone; the path that comes out is only a start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, bound_margin_db, connection_probability
from planopt.planning.search.lattice_window import Window
from planopt.planning.search.node_field import NodeField
from planopt.planning.tolerances import MARGIN_PAD_DB
from planopt.planning.worth.rules.planned import Guide
from planopt.planning.worth.situation import Situation
from planopt.problems.objective import Term
from planopt.problems.problem import Problem

Nodes = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Rows and columns of single nodes."""

EVERYWHERE: Window = slice(None), slice(None)

MISSING_DB_SHARE = 10.0
"""What a missing dB costs, in units of the largest reward of a step. A step that misses at all
costs as much as all steps can gain: no reward is worth it."""


class StageRewards:
    """Rewards of one situation, as the lattice search asks for them.

    Parameters
    ----------
    situation
        What is known.
    field
        Predictions at the nodes, refreshed for the situation.
    guide
        How the rule of connectivity is minded.
    """

    def __init__(self, situation: Situation, field: NodeField, guide: Guide) -> None:
        self._situation = situation
        self._guide = guide
        self._field = field
        shape = field.mean_db.shape
        self._alone: NDArray[np.float64] | None = None
        for term in situation.problem.terms:
            found = term.node_reward(situation, field)
            if found is not None:
                alone = term.weight * found
                self._alone = alone if self._alone is None else self._alone + alone
        self._largest = self._largest_reward()
        # Nodes that are not free, or out of reach, are left at these.
        self._chance, self._fixed = np.zeros(shape), np.full(shape, -np.inf)
        # The same at steps that nothing is asked of.
        self._unasked = self._fixed if guide.asked.all() else self._fixed.copy()
        self._credit = self._largest * guide.credit
        self._look_at(field.window)

    def __call__(self, stage: int, window: Window) -> NDArray[np.float64]:
        """Reward of ending step `stage` (1..N) at each node of the window."""
        return self._rewards(window, stage - 1)

    def along(self, nodes: NDArray[np.intp]) -> NDArray[np.float64]:
        """Reward of ending step k at the k-th of `nodes` (N, 2), given as (iy, ix); ``(N,)``."""
        return self._rewards((nodes[:, 0], nodes[:, 1]), np.arange(len(nodes)))

    def corrected(self, nodes: NDArray[np.intp]) -> None:
        """Take notice of new predictions in the field, at `nodes` (n, 2)."""
        self._look_at((nodes[:, 0], nodes[:, 1]))

    def _rewards(self, where: Window | Nodes, stage: int | NDArray[np.intp]) -> NDArray[np.float64]:
        reward = np.where(self._guide.asked[stage], self._fixed[where], self._unasked[where])
        if self._credit.any():
            reward += self._credit[stage] * self._chance[where]
        for term in self._situation.problem.terms:
            found = term.stage_reward(
                self._situation, self._field.grid_m[where], stage, self._chance[where]
            )
            if found is not None:
                found *= term.weight
                reward += found
        return reward

    def _look_at(self, where: Window | Nodes) -> None:
        """Turn predictions into what does not depend on the stage."""
        problem = self._situation.problem
        radio = problem.stations[0]
        mean, deviation = self._field.mean_db[where], self._field.deviation_db[where]
        known = np.isfinite(mean)
        chance = connection_probability(mean, deviation, radio.threshold_dbm)
        self._chance[where] = np.where(known, chance, 0.0)
        fixed = np.zeros_like(mean) if self._alone is None else self._alone[where]
        for term in problem.terms:
            fixed = fixed + term.weight * self._by_power(term, where, chance)
        self._unasked[where] = np.where(known, fixed, -np.inf)
        if self._guide.asked.any():
            margin = bound_margin_db(mean, deviation, radio.threshold_dbm, self._guide.level)
            missing = np.maximum(MARGIN_PAD_DB - margin, 0.0)
            cost = MISSING_DB_SHARE * missing + problem.planner.horizon * (missing > 0.0)
            fixed = fixed - self._largest * cost
        self._fixed[where] = np.where(known, fixed, -np.inf)

    def _by_power(
        self, term: Term, where: Window | Nodes, chance: NDArray[np.float64]
    ) -> NDArray[np.float64] | float:
        """What a term gives for the power at a place, whenever it is visited."""
        powers = [
            Prediction(station.mean_db[where], station.deviation_db[where])
            for station in self._field.stations
        ]
        found = term.power_reward(self._situation, powers, chance)
        return 0.0 if found is None else found

    def _largest_reward(self) -> float:
        """The largest reward of a step."""
        largest = 0.0 if self._alone is None else float(np.nanmax(np.abs(self._alone), initial=0.0))
        for term in self._situation.problem.terms:
            largest += term.weight * term.most_stage_reward
            each = self._by_power(term, EVERYWHERE, np.ones(1))
            largest += term.weight * float(np.nanmax(np.abs(each), initial=0.0))
        return max(largest, 1e-9)


def move_values(problem: Problem, lengths_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """What moves of these lengths are worth in themselves: their energy, negative.

    Where measurements share what they tell, standing still is not a move: measuring at one place
    twice is worth less than the stand-in says.
    """
    value = np.zeros(len(lengths_m))
    for term in problem.terms:
        value += term.weight * term.move_reward(lengths_m, problem.planner.step_s)
    if any(term.shares_places for term in problem.terms):
        value[lengths_m == 0.0] = -np.inf
    return value
