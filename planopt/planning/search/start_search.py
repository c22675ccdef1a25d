"""Starts for the refinement of a sum of terms: the best ways found by search, all told apart.

A lattice is searched stage by stage, and paths to its best ends, apart from each other, are traced
back. What ending a step at a node is worth is exact for terms that add up. Terms that couple the
places of a path cannot be searched by dynamic programming: in their place stands what a place would
be worth alone, and the path that comes out is only a start.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import bound_margin_db, connection_probability
from planopt.parts import calling
from planopt.planning.candidates import UNLIMITED, Budget
from planopt.planning.programme.goal_value import GoalCharge
from planopt.planning.scene import Ground, first_moves
from planopt.planning.search.coupled_starts import CoupledStarts
from planopt.planning.search.lattice_search import LatticeSearch, MoveValues
from planopt.planning.search.moving_moves import (
    MovingMoves,
    Window,
    first_steps_apart,
    move_table,
)
from planopt.planning.search.node_margins import NodeField
from planopt.planning.search.place_paths import TriedPlaces
from planopt.planning.tolerances import (
    CLEARANCE_TOLERANCE_M,
    MARGIN_PAD_DB,
    STANDSTILL_M,
    STEP_PAD_M,
)
from planopt.planning.values.context import StepContext, bends_starts, shares_places
from planopt.planning.values.objective_value import ObjectiveValue, rule_missing
from planopt.planning.values.rule_rows import Guide, find_guided
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive
from planopt.world.moving_discs import paths_gap_m
from planopt.world.workspace import LONGEST_MOVE

Nodes = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Rows and columns of single nodes."""

MISSING_DB_SHARE = 10.0
"""What a missing dB costs, in units of the largest reward of a step. A step that misses at all
costs as much as all steps can gain: no reward is worth it."""


class StageRewards:
    """Rewards of one situation, as the lattice search asks for them."""

    def __init__(self, situation: StepContext, field: NodeField, guide: Guide) -> None:
        self._situation = situation
        self._guide = guide
        self._field = field
        shape = field.mean_db.shape
        self._alone: NDArray[np.float64] | None = None
        for term in situation.problem.terms:
            with calling(term, "node_reward", key="objective.terms"):
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
            with calling(term, "stage_reward", key="objective.terms"):
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
        self._unasked[where] = np.where(known, fixed, -np.inf)
        if self._guide.asked.any():
            margin = bound_margin_db(mean, deviation, radio.threshold_dbm, self._guide.level)
            missing = np.maximum(MARGIN_PAD_DB - margin, 0.0)
            cost = MISSING_DB_SHARE * missing + problem.planner.horizon * (missing > 0.0)
            fixed = fixed - self._largest * cost
        self._fixed[where] = np.where(known, fixed, -np.inf)

    def _largest_reward(self) -> float:
        """The largest reward of a step."""
        largest = 0.0 if self._alone is None else float(np.nanmax(np.abs(self._alone), initial=0.0))
        for term in self._situation.problem.terms:
            with calling(term, "largest_stage_reward", key="objective.terms"):
                largest += term.weight * term.largest_stage_reward(self._situation)
        return max(largest, 1e-9)


def move_values(problem: Problem, lengths_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the value of moves of these lengths by themselves: their energy, negative.

    Where measurements share what they tell, standing still is not a move: measuring at one place
    twice is worth less than the stand-in says.
    """
    value = np.zeros(len(lengths_m))
    for term in problem.terms:
        with calling(term, "move_reward", key="objective.terms"):
            value += term.weight * term.move_reward(lengths_m, problem.planner.step_s)
    if shares_places(problem):
        value[lengths_m == 0.0] = -np.inf
    return value


STARTS = 2
"""Starts that are handed on, best first."""

THOROUGH_STARTS = 4
"""The same where all are followed."""

THOROUGH_ENDS = 3
"""Ends of lattice paths that are then followed, the best of each part of the reachable places."""

ENDS_APART_STEPS = 2.0
"""How far apart such ends are along an axis, in longest steps."""

COUPLED_STARTS = 3
"""The same where terms couple places, and values have more maxima: of these more are followed."""

CORRECTIONS = 6
"""How often the lattice is searched again after the nodes of its path got better values."""

SETTLED_SHARE = 1e-3
"""It is not searched again for losing a smaller share of the path's value."""

EQUAL_M = 1e-6
"""Paths that are nowhere farther apart than this are one."""


@dataclass(frozen=True, eq=False)
class Start:
    """A way that a refinement may start from."""

    path_m: NDArray[np.float64]  # (N, 2)
    worth: float  # What it is worth by all terms
    # By how much it misses the rule of connectivity, as
    # :func:`planopt.planning.values.objective_value.rule_missing` counts
    missing_db: float
    # How a robot drives it that cannot turn or stop at will; None for any other
    drive: Drive | None = None
    clear: bool = True  # Whether the robot can drive it as it is, clear of obstacles
    # What the way to a goal is charged by in a refinement; None where none is
    charge: GoalCharge | None = None


def without_waiting(
    position_m: NDArray[np.float64], path_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a path (N, 2) that waits at its end for as long as this one does at its beginning.

    Refining cannot make one of the other: a plan that waits would be put off step by step.
    """
    away = np.linalg.norm(path_m - position_m, axis=1) > STANDSTILL_M
    waits = int(away.argmax())
    return np.vstack([path_m[waits:], np.repeat(path_m[-1:], waits, axis=0)])


class StartSearch:
    """Finds starts for one robot of a problem; keeps its map of the channel."""

    def __init__(self, problem: Problem, ground: Ground, thorough: bool = False) -> None:
        self._ends, self._starts = (THOROUGH_ENDS, THOROUGH_STARTS) if thorough else (1, STARTS)
        self._problem = problem
        self._ground = ground
        self._field = NodeField(ground.road_map.lattice)
        self._table = move_table(ground.road_map.lattice)
        self._move_values = move_values(problem, ground.road_map.lengths_m)
        # One step ahead the directions of the fan are all there is to compare, and few.
        self._bends = bends_starts(problem) or problem.planner.horizon == 1
        self._may_bend = bends_starts(problem, steered=False)
        # Built where it is first needed: its raster of distances is dear.
        self._coupled: CoupledStarts | None = None
        tries = any(term.tries_places for term in problem.terms)
        self._tried = TriedPlaces(problem, ground) if tries else None

    def find_starts(
        self,
        situation: StepContext,
        shifted_m: NDArray[np.float64] | None,  # (N, 2) the last plan, one step later, or None
        budget: Budget = UNLIMITED,
    ) -> list[Start]:
        """The best starts, best first: those that keep the bound before those that do not."""
        problem = self._problem
        reach = problem.step_length_m * problem.planner.horizon
        self._field.refresh(situation, reach)
        if shifted_m is not None:
            situation.soon(shifted_m)
        paths = self._lattice_paths(situation, 1, budget)
        if shifted_m is not None:
            paths += [shifted_m, without_waiting(situation.position_m, shifted_m)]
        if situation.steering is not None:
            longest = problem.step_length_m - STEP_PAD_M
            paths.append(situation.steering.path_m(problem.planner.horizon, longest))
        bends = self._may_bend and (self._bends or situation.steering is None)
        if bends:
            if self._coupled is None:
                self._coupled = CoupledStarts(problem, self._ground)
            paths += self._coupled.find_ways(situation, paths, budget)
        if self._tried is not None:
            paths += self._tried.find_ways(situation, self._field)
        if self._ends > 1 and not budget.searched:
            # Besides what is found otherwise, so that being thorough loses no start.
            paths += self._lattice_paths(situation, self._ends, budget)
        paths = list({path.tobytes(): path for path in self._apart(situation, paths)}.values())
        starts = [
            Start(path, worth, rule_missing(situation, path))
            for path, worth in zip(paths, ObjectiveValue(situation).of_each(paths), strict=True)
        ]
        starts.sort(key=lambda start: (round(start.missing_db, 2), -start.worth))
        count = max(self._starts, COUPLED_STARTS) if bends else self._starts
        kept: list[Start] = []
        for start in starts:
            if len(kept) < count and all(
                np.abs(start.path_m - other.path_m).max() > EQUAL_M for other in kept
            ):
                kept.append(start)
        return kept

    def _apart(
        self, situation: StepContext, paths: list[NDArray[np.float64]]
    ) -> list[NDArray[np.float64]]:
        """The paths that keep from all that moves; all of them where none does."""
        moving = situation.moving
        if not len(moving):
            return paths
        kept = [
            path
            for path in paths
            if paths_gap_m(moving, np.vstack([situation.position_m, path])[None])[0]
            >= -CLEARANCE_TOLERANCE_M
        ]
        return kept or paths

    def _lattice_paths(
        self, situation: StepContext, ends: int, budget: Budget
    ) -> list[NDArray[np.float64]]:
        """The best paths on the lattice, under every guide that suits the rule of connectivity.

        Once there are some, further guides are followed until searches end.
        """
        found = False

        def search(guide: Guide) -> list[NDArray[np.float64]]:
            nonlocal found
            if found and budget.searched:
                return []
            paths = self._guided_paths(situation, guide, ends, budget)
            found = found or bool(paths)
            return paths

        return find_guided(situation, search, lambda path: rule_missing(situation, path) == 0.0)

    def _guided_paths(
        self, situation: StepContext, guide: Guide, ends: int, budget: Budget
    ) -> list[NDArray[np.float64]]:
        """The best paths under a guide; the first with good values where it rests on them."""
        nodes, lengths = first_moves(self._ground, self._problem, situation.position_m)
        road_map = self._ground.road_map
        moving = situation.moving
        kept = first_steps_apart(moving, situation.position_m, road_map.nodes_m[nodes])
        nodes, lengths = nodes[kept], lengths[kept]
        if not len(nodes):
            return []
        first = np.stack([road_map.rows[nodes], road_map.columns[nodes]], axis=1)
        first_value = move_values(self._problem, lengths)
        rewards = StageRewards(situation, self._field, guide)
        paths: list[NDArray[np.intp]] = []
        in_step = MovingMoves(road_map.lattice, moving) if len(moving) else None
        moves = MoveValues(self._table, self._move_values, moving=in_step)
        search = LatticeSearch(moves, first, first_value, self._problem.planner.horizon)
        for _ in range(CORRECTIONS + 1):
            found = search(rewards)
            apart = int(ENDS_APART_STEPS * LONGEST_MOVE)
            paths = [found.path_to(end) for end in found.best_ends(ends, apart)]
            if not paths or budget.searched or not self._loses(rewards, paths[0], guide):
                break
        return [self._field.places_m(path) for path in paths]

    def _loses(self, rewards: StageRewards, path: NDArray[np.intp], guide: Guide) -> bool:
        """Return whether the path is worth less once its nodes have good values.

        They get them where the bound rests on them.
        """
        if not (guide.asked.any() or guide.credit.any()):
            return False
        before = float(rewards.along(path).sum())
        if not self._field.correct(path):
            return False
        rewards.corrected(path)
        return float(rewards.along(path).sum()) < before - SETTLED_SHARE * abs(before)
