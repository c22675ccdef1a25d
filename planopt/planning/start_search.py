"""Where the polish of a sum of terms starts from: the best ways found by search, all told apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import bound_margin_db
from planopt.planning.ground import Ground, first_moves
from planopt.planning.local_worth import is_stagewise
from planopt.planning.node_field import NodeField
from planopt.planning.path_worth import PathWorth
from planopt.planning.predictions import search_prediction
from planopt.planning.reward_lattice import best_end, move_table, path_to, search_rewards
from planopt.planning.situation import Situation
from planopt.planning.stage_rewards import StageRewards, move_values
from planopt.planning.straight_starts import straight_starts
from planopt.problems.problem import Problem

STARTS = 2
"""Starts that are handed on, best first."""

CORRECTIONS = 6
"""How often the lattice is searched again after the nodes of its path got better values."""

EQUAL_M = 1e-6
"""Paths that are nowhere farther apart than this are one."""


@dataclass(frozen=True, eq=False)
class Start:
    """A way that a polish may start from.

    Attributes
    ----------
    path_m
        ``(N, 2)``.
    worth
        What it is worth by all terms.
    missing_db
        By how much its steps miss the connectivity bound, in all.
    """

    path_m: NDArray[np.float64]
    worth: float
    missing_db: float


class StartSearch:
    """Finds starts for one robot of a problem; keeps its map of the channel.

    Parameters
    ----------
    problem
        With one robot and a sum of terms.
    ground
        Its geometry.
    """

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem = problem
        self._ground = ground
        self._field = NodeField(ground.road_map.lattice)
        self._table = move_table(ground.road_map.lattice)

    def find_starts(
        self, situation: Situation, shifted_m: NDArray[np.float64] | None
    ) -> list[Start]:
        """The best starts, best first: those that keep the bound before those that do not.

        Parameters
        ----------
        situation
            What is known.
        shifted_m
            ``(N, 2)`` the last plan, one step later, or None.
        """
        problem = self._problem
        reach = problem.step_length_m * problem.planner.horizon
        self._field.refresh(situation.posterior, situation.position_m, reach)
        paths: list[NDArray[np.float64]] = []
        lattice = self._lattice_path(situation)
        if lattice is not None:
            paths.append(lattice)
        if not is_stagewise(problem):
            paths += straight_starts(situation, self._ground.index, problem.planner.horizon)
        if shifted_m is not None and len(shifted_m) == problem.planner.horizon:
            paths.append(shifted_m)
        worth = PathWorth(situation)
        starts = [Start(path, worth(path), self._missing_db(situation, path)) for path in paths]
        starts.sort(key=lambda start: (round(start.missing_db, 2), -start.worth))
        kept: list[Start] = []
        for start in starts:
            if len(kept) < STARTS and all(
                np.abs(start.path_m - other.path_m).max() > EQUAL_M for other in kept
            ):
                kept.append(start)
        return kept

    def _lattice_path(self, situation: Situation) -> NDArray[np.float64] | None:
        """The best path on the lattice, with good values where it rests on them."""
        nodes, lengths = first_moves(self._ground, self._problem, situation.position_m)
        if not len(nodes):
            return None
        road_map = self._ground.road_map
        first = np.stack([road_map.rows[nodes], road_map.columns[nodes]], axis=1)
        path = self._search(situation, first, lengths)
        if self._problem.constraints.p_min > 0.0:
            for _ in range(CORRECTIONS):
                if path is None or not self._field.correct(path):
                    break
                path = self._search(situation, first, lengths)
        return None if path is None else self._field.places_m(path)

    def _search(
        self, situation: Situation, first: NDArray[np.intp], lengths_m: NDArray[np.float64]
    ) -> NDArray[np.intp] | None:
        """Nodes (N, 2) of the best path by the field as it is; None if there is no way."""
        found = search_rewards(
            self._table,
            first,
            move_values(self._problem, lengths_m),
            move_values(self._problem, self._ground.road_map.lengths_m),
            self._problem.planner.horizon,
            StageRewards(situation, self._field),
        )
        end = best_end(found)
        return None if end is None else path_to(found, end)

    def _missing_db(self, situation: Situation, path_m: NDArray[np.float64]) -> float:
        if self._problem.constraints.p_min == 0.0:
            return 0.0
        power = search_prediction(situation.posterior, path_m)
        margins = bound_margin_db(
            power.mean_db,
            power.deviation_db,
            self._problem.stations[0].threshold_dbm,
            self._problem.constraints.p_min,
        )
        return float(np.maximum(-margins, 0.0).sum())
