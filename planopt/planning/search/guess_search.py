"""Initial guesses for sums of terms: the best distinct paths found by search.

Terms that couple the positions of a path are approximated by the sum over single positions.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.kriging import bound_margin_db, connection_probability
from planopt.parts import calling
from planopt.planning.candidates import UNLIMITED, Budget
from planopt.planning.programme.goal_value import GoalCharge, LocalModel
from planopt.planning.scene import Ground, first_moves
from planopt.planning.search.fan_guesses import FanGuesses
from planopt.planning.search.lattice_search import (
    LatticeSearch,
    MoveValues,
    MovingMoves,
    Window,
    first_steps_apart,
    move_table,
)
from planopt.planning.search.node_margins import NodeField
from planopt.planning.search.place_paths import ProbedPlaces
from planopt.planning.tolerances import (
    CLEARANCE_TOLERANCE_M,
    MARGIN_PAD_DB,
    STANDSTILL_M,
    STEP_PAD_M,
)
from planopt.planning.values.context import StepContext, bends_guesses, shares_places
from planopt.planning.values.objective_value import (
    Guide,
    ObjectiveValue,
    RuleRows,
    find_guided,
    rule_missing,
)
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive
from planopt.world.motion import paths_gap_m

Nodes = tuple[Indices, Indices]
"""Rows and columns of individual nodes."""
MISSING_DB_SHARE = 10.0  # Cost of a missing dB relative to the largest reward of a step


class StageRewards:
    """Rewards of lattice nodes at each stage of a plan, in one step context."""

    def __init__(self, context: StepContext, field: NodeField, guide: Guide) -> None:
        self._context = context
        self._guide = guide
        self._field = field
        shape = field.mean_db.shape
        self._alone: Floats | None = None
        for term in context.problem.terms:
            with calling(term, "node_reward", key="objective.terms"):
                found = term.node_reward(context, field)
            if found is not None:
                alone = term.weight * found
                self._alone = alone if self._alone is None else self._alone + alone
        # The largest reward of a single step.
        largest = 0.0 if self._alone is None else float(np.nanmax(np.abs(self._alone), initial=0.0))
        for term in context.problem.terms:
            with calling(term, "largest_stage_reward", key="objective.terms"):
                largest += term.weight * term.largest_stage_reward(context)
        self._largest = max(largest, 1e-9)
        # Blocked or unreachable nodes keep these values.
        self._chance, self._fixed = np.zeros(shape), np.full(shape, -np.inf)
        # Rewards of unconstrained steps.
        self._unbounded = self._fixed if guide.bounded.all() else self._fixed.copy()
        self._credit = self._largest * guide.credit
        self._look_at(field.window)

    def __call__(self, stage: int, window: Window) -> Floats:
        """Return the reward of ending step `stage` (1..N) at each node of the window."""
        return self._rewards(window, stage - 1)

    def along(self, nodes: Indices) -> Floats:
        """Return the rewards of ending step k at the k-th of `nodes` (N, 2), indices (iy, ix)."""
        return self._rewards((nodes[:, 0], nodes[:, 1]), np.arange(len(nodes)))

    def corrected(self, nodes: Indices) -> None:
        """Update the rewards after more accurate power predictions at `nodes` (n, 2)."""
        self._look_at((nodes[:, 0], nodes[:, 1]))

    def _rewards(self, where: Window | Nodes, stage: int | Indices) -> Floats:
        reward = np.where(self._guide.bounded[stage], self._fixed[where], self._unbounded[where])
        if self._credit.any():
            reward += self._credit[stage] * self._chance[where]
        for term in self._context.problem.terms:
            with calling(term, "stage_reward", key="objective.terms"):
                found = term.stage_reward(
                    self._context, self._field.grid_m[where], stage, self._chance[where]
                )
            if found is not None:
                found *= term.weight
                reward += found
        return reward

    def _look_at(self, where: Window | Nodes) -> None:
        """Compute the part of the nodes' rewards that is equal for all stages."""
        problem = self._context.problem
        radio = problem.stations[0]
        mean, deviation = self._field.mean_db[where], self._field.deviation_db[where]
        known = np.isfinite(mean)
        chance = connection_probability(mean, deviation, radio.threshold_dbm)
        self._chance[where] = np.where(known, chance, 0.0)
        fixed = np.zeros_like(mean) if self._alone is None else self._alone[where]
        self._unbounded[where] = np.where(known, fixed, -np.inf)
        if self._guide.bounded.any():
            margin = bound_margin_db(mean, deviation, radio.threshold_dbm, self._guide.level)
            missing = np.maximum(MARGIN_PAD_DB - margin, 0.0)
            cost = MISSING_DB_SHARE * missing + problem.planner.horizon * (missing > 0.0)
            fixed = fixed - self._largest * cost
        self._fixed[where] = np.where(known, fixed, -np.inf)


def move_values(problem: Problem, lengths_m: Floats) -> Floats:
    """Return the values of moves with lengths `lengths_m`: minus the energy of motion."""
    # Waiting is excluded if another measurement at the same position is redundant.
    value = np.zeros(len(lengths_m))
    for term in problem.terms:
        with calling(term, "move_reward", key="objective.terms"):
            value += term.weight * term.move_reward(lengths_m, problem.planner.step_s)
    if shares_places(problem):
        value[lengths_m == 0.0] = -np.inf
    return value


GUESSES = 2  # Maximum number of returned guesses
COUPLED_GUESSES = 3
"""Maximum number of returned guesses if terms couple positions and thus have more maxima."""
CORRECTIONS = 6  # Maximum number of repeated searches with corrected predictions along the path
SETTLED_SHARE = 1e-3  # Minimum relative loss of a path's value that triggers another search
EQUAL_M = 1e-6  # Distance within which corresponding positions of two paths count as equal


@dataclass(frozen=True, eq=False)
class Guess:
    """Initial guess of a refinement, with its objective value."""

    path_m: Floats  # (N, 2)
    value: float  # Objective value
    missing_db: float  # Violation of the connectivity rule in dB (`rule_missing`)
    drive: Drive | None = None  # Drive of a robot with dynamics
    clear: bool = True  # Whether the unrefined path is feasible and collision-free
    charge: GoalCharge | None = None  # Goal cost in a refinement; None without a goal
    # Maps context, path (N, 2) and rows to a local model; None for a sum of terms
    near: Callable[[StepContext, Floats, RuleRows], LocalModel] | None = None
    held: Mask | None = None  # (N,) positions that a refinement for a sum of terms keeps


def without_waiting(position_m: Floats, path_m: Floats) -> Floats:
    """Return a path (N, 2) with the initial waiting steps moved to its end."""
    # A refinement cannot do this, and a plan that waits first would be postponed at every step.
    away = np.linalg.norm(path_m - position_m, axis=1) > STANDSTILL_M
    waits = int(away.argmax())
    return np.vstack([path_m[waits:], np.repeat(path_m[-1:], waits, axis=0)])


class GuessSearch:
    """Search for initial guesses of one robot; it caches the predicted channel map."""

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem = problem
        self._ground = ground
        self._field = NodeField(ground.road_map.lattice)
        self._table = move_table(ground.road_map.lattice)
        self._move_values = move_values(problem, ground.road_map.lengths_m)
        # For N = 1, the fan compares all directions.
        self._bends = bends_guesses(problem) or problem.planner.horizon == 1
        self._may_bend = bends_guesses(problem, steered=False)
        # Built on first use because its raster of clearances is expensive.
        self._fan: FanGuesses | None = None
        probes = any(term.probes_end for term in problem.terms)
        self._probed = ProbedPlaces(problem, ground) if probes else None

    def find_guesses(
        self, context: StepContext, shifted_m: Floats | None, budget: Budget = UNLIMITED
    ) -> list[Guess]:
        """Return initial guesses, sorted by satisfaction of the rule, then by value."""
        # Shapes: shifted_m (N, 2), the last plan shifted by one step, or None.
        problem = self._problem
        reach = problem.step_length_m * problem.planner.horizon
        self._field.refresh(context, reach)
        if shifted_m is not None:
            context.soon(shifted_m)
        paths = self._lattice_paths(context, budget)
        if shifted_m is not None:
            paths += [shifted_m, without_waiting(context.position_m, shifted_m)]
        if context.steering is not None:
            longest = problem.step_length_m - STEP_PAD_M
            paths.append(context.steering.path_m(problem.planner.horizon, longest))
        bends = self._may_bend and (self._bends or context.steering is None)
        if bends:
            if self._fan is None:
                self._fan = FanGuesses(problem, self._ground)
            paths += self._fan.find_paths(context, paths, budget)
        if self._probed is not None:
            paths += self._probed.find_paths(context, self._field)
        paths = list({path.tobytes(): path for path in self._apart(context, paths)}.values())
        guesses = [
            Guess(path, value, rule_missing(context, path))
            for path, value in zip(paths, ObjectiveValue(context).of_each(paths), strict=True)
        ]
        guesses.sort(key=lambda guess: (round(guess.missing_db, 2), -guess.value))
        count = COUPLED_GUESSES if bends else GUESSES
        kept: list[Guess] = []
        for guess in guesses:
            if len(kept) < count and all(
                np.abs(guess.path_m - other.path_m).max() > EQUAL_M for other in kept
            ):
                kept.append(guess)
        return kept

    def _apart(self, context: StepContext, paths: list[Floats]) -> list[Floats]:
        """Return the paths that avoid moving obstacles, or all paths if none avoids them."""
        moving = context.moving
        if not len(moving):
            return paths
        kept = [
            path
            for path in paths
            if paths_gap_m(moving, np.vstack([context.position_m, path])[None])[0]
            >= -CLEARANCE_TOLERANCE_M
        ]
        return kept or paths

    def _lattice_paths(self, context: StepContext, budget: Budget) -> list[Floats]:
        """Return the best lattice paths, one for each guide of the connectivity rule."""
        # After the first path, the search stops once its time budget is spent.
        found = False

        def search(guide: Guide) -> list[Floats]:
            nonlocal found
            if found and budget.searched:
                return []
            paths = self._guided_paths(context, guide, budget)
            found = found or bool(paths)
            return paths

        return find_guided(context, search, lambda path: rule_missing(context, path) == 0.0)

    def _guided_paths(self, context: StepContext, guide: Guide, budget: Budget) -> list[Floats]:
        """Return a list with the best lattice path under a guide; empty if there is none."""
        nodes, lengths = first_moves(self._ground, self._problem, context.position_m)
        road_map = self._ground.road_map
        moving = context.moving
        kept = first_steps_apart(moving, context.position_m, road_map.nodes_m[nodes])
        nodes, lengths = nodes[kept], lengths[kept]
        if not len(nodes):
            return []
        first = np.stack([road_map.rows[nodes], road_map.columns[nodes]], axis=1)
        first_value = move_values(self._problem, lengths)
        rewards = StageRewards(context, self._field, guide)
        path: Indices | None = None
        in_step = MovingMoves(road_map.lattice, moving) if len(moving) else None
        moves = MoveValues(self._table, self._move_values, moving=in_step)
        search = LatticeSearch(moves, first, first_value, self._problem.planner.horizon)
        for _ in range(CORRECTIONS + 1):
            path = search(rewards).best_path()
            if path is None or budget.searched or not self._loses(rewards, path, guide):
                break
        return [] if path is None else [self._field.places_m(path)]

    def _loses(self, rewards: StageRewards, path: Indices, guide: Guide) -> bool:
        """Correct the predictions at a path's nodes; return whether the path's value decreases."""
        if not (guide.bounded.any() or guide.credit.any()):
            return False
        before = float(rewards.along(path).sum())
        if not self._field.correct(path):
            return False
        rewards.corrected(path)
        return float(rewards.along(path).sum()) < before - SETTLED_SHARE * abs(before)
