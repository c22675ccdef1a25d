"""Planners that a problem file can select by name, including the baselines.

The one-step planner follows [GM11]: it maximises their objectives (2), (3, inner layer) or (4) over
a dense set of positions within one step. The communication strategies of [GM11] assume a simpler
channel: path loss without shadowing, a disc in which all packets arrive, or a lossless link.

Performance bounds of tracking know the future and plan the whole run at once. The clairvoyant
planner knows the target's path and the power at every position, the oracle all but multipath. Both
maximise the received information or, with the suffix ``_log``, the expected value of
log(1 + information * initial variance).
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Literal, Protocol

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.channel.ground_truth import Truth, mean_power_dbm, true_power_dbm
from planopt.channel.kriging import score_probability
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters
from planopt.channel.posterior import condition
from planopt.errors import InputError
from planopt.parts import calling, class_name, part_of
from planopt.planning.candidates import Scorer, held, released
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.plan import BEGINNING, Plan
from planopt.planning.scene import (
    Ground,
    PathsFrom,
    build_ground,
    first_moves,
    free_ends,
    stops_along,
)
from planopt.planning.search.lattice_search import (
    LatticeSearch,
    MoveValues,
    Window,
    move_table,
    steps_apart,
)
from planopt.planning.search.local_ranking import LocalRanking
from planopt.planning.search.place_paths import path_to_unmeasured
from planopt.planning.tolerances import STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import StepContext, learns
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.problems.problem import Problem, problem_of_robot
from planopt.problems.settings import planner_kind
from planopt.targets.information_filter import sensing_information
from planopt.world.lattice import MOVES, RoadMap, lattice_paths, route_from

KEY = "planner.name"


class Planner(Protocol):
    """Protocol of single-robot planners for problems whose objective is a sum of terms."""

    def plan(self, context: StepContext, scorer: Scorer, warm: Plan | None = None) -> Plan:
        """Return a plan from the robot's state; `warm` is the previous plan."""
        ...


def planner_for(problem: Problem, ground: Ground, generator: np.random.Generator) -> Planner:
    """Return the planner selected by `problem.planner.name`."""
    kind = planner_kind(problem.planner.name)
    if kind.foresees:
        raise InputError(
            f"is {kind.name}, a bound that requires the ground truth of a whole run",
            file=problem.file,
            key="planner.name",
            remedy="use it with simulate or compare, or choose another planner",
        )
    make = kind.maker()
    with calling(make, "", key=KEY, remedy="take a problem, its geometry and a random generator"):
        made = make(problem, ground, generator)
    if not callable(getattr(made, "plan", None)):
        raise InputError(
            f"is {kind.name!r}, but {class_name(made)} does not define the method plan",
            key=KEY,
            remedy="define plan(self, context, scorer, warm=None), which returns released(...)",
        )
    return made


def plan_of(
    planner: Planner, context: StepContext, scorer: Scorer, warm: Plan | None = None
) -> Plan:
    """Return the plan of a planner; faults of user-defined planners raise InputErrors."""
    remedy = "return released(scorer, path_m, begun_s), of a path (N, 2)"
    with calling(planner, "plan", key=KEY, remedy=remedy):
        plan = planner.plan(context, scorer, warm)
    part_of(f"{KEY}: the result of {class_name(planner)}.plan", plan, Plan, remedy)
    return plan


RINGS, HEADINGS = 10, 48  # Number of radii and directions of the grid of positions within a step
Score = Callable[[StepContext, Floats], Floats]
"""Function that maps paths (c, N, 2) to their scores (c,)."""


def as_ranked(context: StepContext, paths_m: Floats) -> Floats:
    """Return the approximate objective values (c,) of paths (c, N, 2), for ranking."""
    return LocalRanking(context, paths_m)(paths_m)


def end_deviation(context: StepContext, paths_m: Floats) -> Floats:
    """Return the standard deviations (c,) of predicted power at the ends of paths (c, N, 2)."""
    return context.predicted(paths_m[:, -1]).deviation_db


class OneStepPlanner:
    """Greedy planner that optimises one step at a time."""

    def __init__(
        self,
        problem: Problem,
        ground: Ground,
        _generator: np.random.Generator | None = None,
        score: Score = as_ranked,
    ) -> None:
        self._problem, self._ground, self._score = problem, ground, score
        self._measures = learns(problem)
        # An expression needs a whole path, so the robot is assumed to wait afterwards.
        self._whole = any(
            term.structure == "full" and not (term.is_measured or term.steers or term.probes_end)
            for term in problem.terms
        )
        radius = (problem.step_length_m - STEP_PAD_M) * np.arange(1, RINGS + 1) / RINGS
        angle = 2.0 * math.pi * np.arange(HEADINGS) / HEADINGS
        circle = np.column_stack([np.cos(angle), np.sin(angle)])
        rings = (radius[:, None, None] * circle).reshape(-1, 2)
        self._offsets_m = np.vstack([np.zeros((1, 2)), rings])

    def plan(self, context: StepContext, scorer: Scorer, warm: Plan | None = None) -> Plan:
        """Return a plan from the robot's position; `warm` is unused."""
        begun = perf_counter()
        path: list[Floats] = []
        for _ in range(self._problem.planner.horizon):
            step = self._best_step(context, path)
            if step is None:
                break
            path.append(step)
        if not path and self._measures:
            out = path_to_unmeasured(context, self._ground)
            path = [] if out is None else list(out)
        return released(scorer, held(context, path), begun)

    def _best_step(self, context: StepContext, path: list[Floats]) -> Floats | None:
        """Return the best next position after `path`; None if no next position is allowed."""
        here = path[-1] if path else context.position_m
        ends = here + self._offsets_m
        allowed = free_ends(self._problem, self._ground, here, ends)
        begins = np.broadcast_to(here, ends.shape)
        before = np.broadcast_to(np.reshape(path, (-1, 2)), (len(ends), len(path), 2))
        allowed &= steps_apart(context.moving, len(path), begins, ends)
        if self._measures:
            ahead = np.concatenate([before, ends[:, None]], axis=1)
            allowed &= context.near_measuring.takes(ahead)[:, -1]
        ends = ends[allowed]
        if not len(ends):
            return None
        paths = np.concatenate([before[allowed], ends[:, None]], axis=1)
        if self._whole:
            rest = self._problem.planner.horizon - int(paths.shape[1])
            paths = np.concatenate([paths, np.repeat(paths[:, -1:], rest, axis=1)], axis=1)
        return ends[int(np.argmax(self._score(context, paths)))]


largest_deviation_planner = partial(OneStepPlanner, score=end_deviation)

DRAWS = 64  # Number of candidate steps drawn at once; the robot waits if none is collision-free
TURN_STD_RAD = 0.4  # Standard deviation of the turn between consecutive steps of a persistent walk
Walk = Literal["full", "disk", "persistent"]
"""Kind of random walk: full steps, uniform positions in the disc, or small turns."""


class RandomPlanner:
    """Planner of a random walk."""

    def __init__(
        self, problem: Problem, ground: Ground, generator: np.random.Generator, walk: Walk = "full"
    ) -> None:
        self._problem, self._ground = problem, ground
        self._generator, self._walk = generator, walk

    def plan(self, context: StepContext, scorer: Scorer, warm: Plan | None = None) -> Plan:
        """Return a plan from the robot's position."""
        begun = perf_counter()
        path: list[Floats] = []
        heading = None if warm is None else _heading(warm.positions_m[1] - warm.positions_m[0])
        here = context.position_m
        for _ in range(self._problem.planner.horizon):
            offsets = self._offsets(heading)
            ends = here + (self._problem.step_length_m - STEP_PAD_M) * offsets
            free = free_ends(self._problem, self._ground, here, ends)
            begins = np.broadcast_to(here, ends.shape)
            free &= steps_apart(context.moving, len(path), begins, ends)
            if not free.any():
                break
            first = int(free.argmax())
            heading, here = _heading(offsets[first]), ends[first]
            path.append(here)
        return released(scorer, held(context, path), begun)

    def _offsets(self, heading: float | None) -> Floats:
        """Return random steps (`DRAWS`, 2) in units of the longest step; `heading` may be None."""
        drawn = self._generator.uniform(-math.pi, math.pi, DRAWS)
        lengths = np.ones(DRAWS)
        if self._walk == "disk":
            lengths = np.sqrt(self._generator.uniform(0.0, 1.0, DRAWS))
        elif self._walk == "persistent" and heading is not None:
            # Half of the directions are uniform, in case all small turns are blocked.
            turns = self._generator.normal(0.0, TURN_STD_RAD, DRAWS // 2)
            drawn[: DRAWS // 2] = heading + turns
        return lengths[:, None] * np.column_stack([np.cos(drawn), np.sin(drawn)])


disk_walk_planner = partial(RandomPlanner, walk="disk")
persistent_walk_planner = partial(RandomPlanner, walk="persistent")


def _heading(step_m: Floats) -> float | None:
    """Return the direction of a step (2,) in rad; None for a waiting step."""
    if np.linalg.norm(step_m) <= STANDSTILL_M:
        return None
    return math.atan2(float(step_m[1]), float(step_m[0]))


FEWEST_LANES = 3
"""Minimum number of lanes, in case the fitted decorrelation distance exceeds the workspace."""


class LawnmowerPlanner:
    """Planner that sweeps the workspace in lanes; it stores the tour and its progress."""

    def __init__(
        self, problem: Problem, ground: Ground, _generator: np.random.Generator | None = None
    ) -> None:
        self._problem, self._ground = problem, ground
        self._tour: Indices | None = None
        self._stops_m: Floats = np.empty((0, 2))
        self._next = 0

    def plan(self, context: StepContext, scorer: Scorer, warm: Plan | None = None) -> Plan:
        """Return a plan along the tour, which restarts if the robot is off it; `warm` is unused."""
        begun = perf_counter()
        here = context.position_m
        ahead = self._stops_m[self._next :]
        away = np.linalg.norm(ahead - here, axis=1)
        if self._tour is None or not (away <= STANDSTILL_M).any():
            self._begin(here, context)
        else:
            self._next += int(np.argmax(away <= STANDSTILL_M))
        horizon = self._problem.planner.horizon
        path = self._stops_m[self._next + 1 : self._next + 1 + horizon]
        return released(scorer, held(context, list(path)), begun)

    def _begin(self, here_m: Floats, context: StepContext) -> None:
        """Compute the stops of a new tour from `here_m` (2,)."""
        road_map = self._ground.road_map
        nodes, lengths = first_moves(self._ground, self._problem, here_m)
        if not len(nodes):
            self._stops_m, self._next = here_m[None], 0
            return
        first = int(nodes[np.argmin(lengths)])
        apart = min(station.parameters.decorrelation_m for station in context.law.posteriors)
        self._tour = lawn_tour(road_map, first, apart)
        longest = self._problem.step_length_m - STEP_PAD_M
        corners = np.vstack([here_m, road_map.nodes_m[self._tour]])
        self._stops_m, self._next = stops_along(corners, longest), 0


def lawn_tour(road_map: RoadMap, first: int, apart_m: float) -> Indices:
    """Return the nodes of a tour in lanes over all free space reachable from `first`."""
    # The lane spacing is `apart_m`, rounded to rows of nodes.
    tour = [first]
    low, high = int(road_map.rows.min()), int(road_map.rows.max())
    lanes = lane_rows(low, high, apart_m / road_map.lattice.spacing_m)
    # Begin at the nearer side.
    if road_map.rows[first] - low > high - road_map.rows[first]:
        lanes.reverse()
    middle = 0.5 * (road_map.columns.min() + road_map.columns.max())
    rightward = bool(road_map.columns[first] <= middle)
    for row in lanes:
        lane = np.flatnonzero(road_map.rows == row)
        lane = lane[np.argsort(road_map.columns[lane])]
        for node in map(int, lane if rightward else lane[::-1]):
            if node != tour[-1]:
                tour += _route(road_map, tour[-1], node)
        rightward = not rightward
    return np.asarray(tour, dtype=np.intp)


def lane_rows(low: int, high: int, apart: float) -> list[int]:
    """Return evenly spaced lattice rows for lanes, about `apart` rows apart."""
    rows = high - low + 1
    count = min(max(math.ceil(rows / apart), FEWEST_LANES), rows)
    middles = low + (np.arange(count) + 0.5) * rows / count - 0.5
    return [int(row) for row in np.rint(middles)]


def _route(road_map: RoadMap, here: int, there: int) -> list[int]:
    """Return the nodes of the shortest path after `here` up to `there`; empty if there is none."""
    moves = road_map.edge_to[road_map.edge_start[here] : road_map.edge_start[here + 1]]
    if there in moves:
        return [there]
    route = route_from(road_map, lattice_paths(road_map, there), here, math.inf)
    return [int(node) for node in route[1:]] if route[-1] == there else []


EDGE_STD_DB = 0.1
"""Standard deviation of power in the disc model, for a gradient at the disc's edge."""
CERTAIN_DB = 300.0  # Path gain at which no packet is lost
Assumed = Callable[[ChannelParameters], ChannelParameters]
"""Function that maps the fitted channel to the channel that a strategy assumes."""


def path_loss_only(parameters: ChannelParameters) -> ChannelParameters:
    """Return the fitted parameters unchanged; without measurements they predict path loss only."""
    return parameters


def informed_disk(parameters: ChannelParameters) -> ChannelParameters:
    """Return a pure path-loss channel: connected within a disc and not beyond."""
    return replace(parameters, shadow_std_db=0.0, multipath_std_db=EDGE_STD_DB)


def unaware(parameters: ChannelParameters) -> ChannelParameters:
    """Return a channel without packet losses."""
    return replace(parameters, k_pl_db=parameters.k_pl_db + CERTAIN_DB)


def _unfit(problem: Problem, words: str) -> InputError:
    """Return the error of a planner whose conditions a problem violates."""
    return InputError(
        f"is {problem.planner.name}, which {words}",
        file=problem.file,
        key="planner.name",
        remedy='use planner.name = "auto"',
    )


class StrategyPlanner:
    """Planner of one target-tracking robot on an assumed channel."""

    def __init__(
        self,
        problem: Problem,
        ground: Ground,
        _generator: np.random.Generator | None = None,
        *,
        assumed: Assumed,
    ) -> None:
        if not any(term.sensor for term in problem.terms) or len(problem.stations) > 1:
            raise _unfit(problem, "needs a tracking term and exactly one station")
        self._problem, self._ground, self._assumed = problem, ground, assumed
        inner = replace(problem, planner=replace(problem.planner, name="auto"))
        self._planner = HorizonPlanner(inner, ground)

    def plan(self, context: StepContext, scorer: Scorer, warm: Plan | None = None) -> Plan:
        """Return a plan optimised on the assumed channel, verified on the actual belief."""
        begun = perf_counter()
        believed = context.posterior
        k_pl_db, n_pl = (float(value) for value in believed.theta)
        parameters = replace(believed.parameters, k_pl_db=k_pl_db, n_pl=n_pl)
        nothing = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=np.bool_))
        channel = condition(self._assumed(parameters), nothing, theta="known")
        path = self._home(context) if self._assumed is informed_disk else None
        if path is None:
            # Measurements do not update the assumed channel, so the history is empty as well.
            seen = replace(context, posteriors=(channel,), uncertain=None, history=BEGINNING)
            assuming = replace(scorer, context=seen, objective=ObjectiveValue(seen))
            path = self._planner.plan(seen, assuming, warm).positions_m[1:]
        return released(scorer, path, begun)

    def _home(self, context: StepContext) -> Floats | None:
        """Return the shortest path (N, 2) to the station; None if contact is within the horizon."""
        believed, station = context.posterior, self._problem.stations[0]
        k_pl_db, n_pl = believed.theta
        slant = 10.0 ** ((k_pl_db - station.threshold_dbm) / (10.0 * n_pl))
        radius = np.sqrt(max(slant**2 - station.height_m**2, 0.0))
        base, here = np.asarray(station.position_m), context.position_m
        horizon, longest = self._problem.planner.horizon, self._problem.step_length_m - STEP_PAD_M
        if np.linalg.norm(base - here) <= radius + horizon * longest:
            return None
        nodes = self._ground.road_map.nodes_m
        paths = PathsFrom(self._problem, self._ground, here)
        away = np.where(np.isfinite(paths.length_m), np.linalg.norm(nodes - base, axis=1), np.inf)
        nearest = int(away.argmin())
        stops = stops_along(paths.turns_m(nearest, nodes[nearest]), longest)[1:]
        return np.concatenate([stops, np.repeat(stops[-1:], horizon, axis=0)])[:horizon]


path_loss_planner = partial(StrategyPlanner, assumed=path_loss_only)
disk_planner = partial(StrategyPlanner, assumed=informed_disk)
unaware_planner = partial(StrategyPlanner, assumed=unaware)


ROUNDS = 5  # Maximum number of rounds in which several robots plan in turn


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
    """Raise an InputError if performance bounds of tracking are undefined for a problem."""
    several = len(problem.robots) > 1 and problem.constraints.separation_m > 0.0
    if (
        not any(term.sensor for term in problem.terms)
        or len(problem.stations) > 1
        or several
        or problem.workspace.moving
        or problem.workspace.timed
        or not all(robot.moves_freely for robot in problem.robots)
    ):
        raise _unfit(
            problem,
            "bounds the tracking error only for problems with one station, single integrators, "
            "no separation_m, and obstacles that neither move, appear nor vanish",
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
        """Return information times initial variance for packets from positions (n, 2) at `step`."""
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
