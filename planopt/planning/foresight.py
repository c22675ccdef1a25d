"""Performance bounds of tracking: planners that know the future and plan the whole run at once.

The clairvoyant planner knows the target's path and the power at every position, the oracle all but
multipath. Both maximise the received information or, with the suffix ``_log``, the expected
logarithm of one plus that information times the initial variance.
"""

from functools import partial
from time import perf_counter

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.channel.ground_truth import Truth, mean_power_dbm, true_power_dbm
from planopt.channel.prediction import score_probability
from planopt.errors import InputError
from planopt.planning.candidates import Scorer, held, released
from planopt.planning.plan import Plan
from planopt.planning.scene import build_ground
from planopt.planning.search.lattice_search import LatticeSearch, MoveValues, Window, move_table
from planopt.planning.values.context import StepContext
from planopt.problems.problem import Problem, problem_of_robot
from planopt.targets.information_filter import sensing_information
from planopt.world.lattice import MOVES, RoadMap

ROUNDS = 5
"""Maximum number of rounds in which several robots plan in turn."""


class FollowingPlanner:
    """Planner that follows a precomputed path for the whole run."""

    def __init__(self, path_m: Floats) -> None:
        self._path_m = path_m

    def plan(self, context: StepContext, scorer: Scorer, warm: Plan | None = None) -> Plan:
        """Return the plan of the next steps; the previous plan `warm` is unused."""
        begun, first = perf_counter(), context.history.steps
        ahead = self._path_m[first : first + context.problem.planner.horizon]
        return released(scorer, held(context, list(ahead)), begun)


def require_foreseeable(problem: Problem) -> None:
    """Raise an InputError if these performance bounds are undefined for a problem."""
    several = len(problem.robots) > 1 and problem.constraints.separation_m > 0.0
    if (
        not any(term.sensor for term in problem.terms)
        or len(problem.stations) > 1
        or several
        or problem.workspace.moving
        or problem.workspace.timed
        or not all(robot.moves_freely for robot in problem.robots)
    ):
        raise InputError(
            f"is {problem.planner.name}, which bounds the tracking error only for problems "
            "with one station, single integrators, no separation_m, and obstacles that "
            "neither move, appear nor vanish",
            file=problem.file,
            key="planner.name",
            remedy='use planner.name = "auto"',
        )


def _paths(
    problem: Problem, truth: Truth, target_m: Floats, *, knows_multipath: bool, saturates: bool
) -> list[Floats]:
    """Return the optimal path (T, 2) of each robot for a known target path (T + 1, 2)."""
    require_foreseeable(problem)
    sensor = next(term.sensor for term in problem.terms if term.sensor is not None)
    threshold, ahead = problem.stations[0].true_threshold_dbm, target_m[1:]
    unknown = float(np.nanstd(truth.raster.values - truth.mean_dbm))

    def arriving(places_m: Floats) -> Floats:
        """Return P(packet delivered) from positions (n, 2)."""
        if knows_multipath or unknown == 0.0:
            return (true_power_dbm(truth, places_m) >= threshold).astype(np.float64)
        return score_probability((mean_power_dbm(truth, places_m) - threshold) / unknown)

    def informing(places_m: Floats, step: int) -> Floats:
        """Return the information of packets from positions (n, 2), times the initial variance."""
        sensed = sensing_information(sensor, places_m, ahead[step])
        # Per coordinate, so that it adds to the inverse of the initial variance.
        return 0.5 * problem.targets[0].position_std_m ** 2 * sensed

    roads: list[tuple[RoadMap, int, Floats]] = []
    for number, robot in enumerate(problem.robots):
        start = np.asarray(robot.start_m)
        road_map = build_ground(problem_of_robot(problem, number), start).road_map
        away = np.linalg.norm(road_map.nodes_m - start, axis=1)
        roads.append((road_map, int(away.argmin()), arriving(road_map.nodes_m)))
    paths = [np.repeat(road.nodes_m[[first]], len(ahead), axis=0) for road, first, _ in roads]
    gained = np.zeros((len(roads), len(ahead)))
    for _ in range(ROUNDS if saturates and len(roads) > 1 else 1):
        before = [path.copy() for path in paths]
        for number, (road_map, first, chance) in enumerate(roads):
            others = gained.sum(axis=0) - gained[number]
            packets = np.array([informing(road_map.nodes_m, step) for step in range(len(ahead))])
            # A packet that is likely lost has a small reward, however close to the target.
            reward = np.log1p(packets / (1.0 + others[:, None])) if saturates else packets
            nodes = best_nodes(road_map, first, chance * reward)
            paths[number] = road_map.nodes_m[nodes]
            gained[number] = chance[nodes] * packets[np.arange(len(ahead)), nodes]
        if all(np.array_equal(*each) for each in zip(before, paths, strict=True)):
            break
    return paths


oracle_paths = partial(_paths, knows_multipath=False, saturates=False)
oracle_log_paths = partial(_paths, knows_multipath=False, saturates=True)
clairvoyant_paths = partial(_paths, knows_multipath=True, saturates=False)
clairvoyant_log_paths = partial(_paths, knows_multipath=True, saturates=True)


def best_nodes(road_map: RoadMap, first: int, rewards: Floats) -> Indices:
    """Return the nodes (T,) of the lattice path with the largest sum of rewards."""
    # Shapes: rewards (T, n).
    rows, columns, lattice = road_map.rows, road_map.columns, road_map.lattice

    def reward(stage: int, window: Window) -> Floats:
        grid = np.full(lattice.shape, -np.inf)
        grid[rows, columns] = rewards[stage - 1]
        return grid[window]

    nodes = road_map.sources[first]
    nodes = nodes[nodes < len(rows)]
    moves = MoveValues(move_table(lattice), np.zeros(len(MOVES)))
    ends = np.stack([rows[nodes], columns[nodes]], axis=1)
    found = LatticeSearch(moves, ends, np.zeros(len(nodes)), len(rewards))(reward)
    path = found.best_path()
    if path is None:
        raise AssertionError("a stationary target stays reachable")
    return road_map.number[path[:, 0], path[:, 1]]
