"""The planners that a problem may name, and the baselines among them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters
from planopt.channel.posterior import condition
from planopt.errors import InputError
from planopt.parts import calling, class_name, part_of
from planopt.planning.candidates import Judge, held, released
from planopt.planning.history import BEGINNING
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.plan import Plan
from planopt.planning.scene import Ground, first_moves, free_ends
from planopt.planning.search.lattice_search import steps_apart
from planopt.planning.search.local_ranking import LocalRanking
from planopt.planning.search.place_paths import way_to_unmeasured
from planopt.planning.search.taut_way import WaysFrom, stops_along
from planopt.planning.tolerances import STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.planning.values.exploration import learns
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.problems.planner_kinds import planner_kind
from planopt.problems.problem import Problem
from planopt.world.lattice import RoadMap, lattice_paths, route_from

RINGS, HEADINGS = 10, 48
"""Places within a step: on so many circles in so many directions, and the robot's own."""


Score = Callable[[StepContext, NDArray[np.float64]], NDArray[np.float64]]
"""From paths (c, N, 2) to what each is worth (c,)."""


def as_ranked(situation: StepContext, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what paths (c, N, 2) are worth by the terms of the problem; ``(c,)``."""
    return LocalRanking(situation, ways_m)(ways_m)


def end_deviation(situation: StepContext, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard deviation of predicted power where paths (c, N, 2) end, dB; ``(c,)``."""
    return situation.power(ways_m[:, -1]).deviation_db


class OneStepPlanner:
    """Plans greedily for one robot of a problem whose objective is a sum of terms."""

    def __init__(self, problem: Problem, ground: Ground, score: Score = as_ranked) -> None:
        self._problem, self._ground, self._score = problem, ground, score
        self._measures = learns(problem)
        # An expression is for a whole path: it is valued as if the robot then stood.
        self._whole = any(
            term.structure == "full" and not (term.is_measured or term.steers or term.probes_end)
            for term in problem.terms
        )
        radius = (problem.step_length_m - STEP_PAD_M) * np.arange(1, RINGS + 1) / RINGS
        angle = 2.0 * math.pi * np.arange(HEADINGS) / HEADINGS
        circle = np.column_stack([np.cos(angle), np.sin(angle)])
        rings = (radius[:, None, None] * circle).reshape(-1, 2)
        self._offsets_m = np.vstack([np.zeros((1, 2)), rings])

    def plan(self, situation: StepContext, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is; arguments as of the horizon planner, `warm` is not used."""
        begun = perf_counter()
        path: list[NDArray[np.float64]] = []
        for _ in range(self._problem.planner.horizon):
            step = self._best_step(situation, path)
            if step is None:
                break
            path.append(step)
        if not path and self._measures:
            out = way_to_unmeasured(situation, self._ground)
            path = [] if out is None else list(out)
        return released(judge, held(situation, path), begun)

    def _best_step(
        self, situation: StepContext, path: list[NDArray[np.float64]]
    ) -> NDArray[np.float64] | None:
        """The best place to go to after `path`; None if there is none."""
        here = path[-1] if path else situation.position_m
        ends = here + self._offsets_m
        allowed = free_ends(self._problem, self._ground, here, ends)
        begins = np.broadcast_to(here, ends.shape)
        before = np.broadcast_to(np.reshape(path, (-1, 2)), (len(ends), len(path), 2))
        allowed &= steps_apart(situation.moving, len(path), begins, ends)
        if self._measures:
            ahead = np.concatenate([before, ends[:, None]], axis=1)
            allowed &= situation.near_measuring.takes(ahead)[:, -1]
        ends = ends[allowed]
        if not len(ends):
            return None
        ways = np.concatenate([before[allowed], ends[:, None]], axis=1)
        if self._whole:
            rest = self._problem.planner.horizon - int(ways.shape[1])
            ways = np.concatenate([ways, np.repeat(ways[:, -1:], rest, axis=1)], axis=1)
        return ends[int(np.argmax(self._score(situation, ways)))]


DRAWS = 64
"""Steps drawn for one; the robot stands still where none is free."""

TURN_STD_RAD = 0.4
"""Standard deviation of the turn from one step of a persistent walk to the next."""

Walk = Literal["full", "disk", "persistent"]
"""Full steps in uniform directions, uniform over the disc of one step, or full steps that turn
little."""


class RandomPlanner:
    """Walks one robot of a problem at random."""

    def __init__(
        self,
        problem: Problem,
        ground: Ground,
        generator: np.random.Generator,
        walk: Walk = "full",
    ) -> None:
        self._problem, self._ground = problem, ground
        self._generator, self._walk = generator, walk

    def plan(self, situation: StepContext, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is."""
        begun = perf_counter()
        path: list[NDArray[np.float64]] = []
        heading = None if warm is None else _heading(warm.positions_m[1] - warm.positions_m[0])
        here = situation.position_m
        for _ in range(self._problem.planner.horizon):
            offsets = self._offsets(heading)
            ends = here + (self._problem.step_length_m - STEP_PAD_M) * offsets
            free = free_ends(self._problem, self._ground, here, ends)
            begins = np.broadcast_to(here, ends.shape)
            free &= steps_apart(situation.moving, len(path), begins, ends)
            if not free.any():
                break
            first = int(free.argmax())
            heading, here = _heading(offsets[first]), ends[first]
            path.append(here)
        return released(judge, held(situation, path), begun)

    def _offsets(self, heading: float | None) -> NDArray[np.float64]:
        """Draw steps (`DRAWS`, 2) in units of the longest, after one in a direction or none."""
        drawn = self._generator.uniform(-math.pi, math.pi, DRAWS)
        lengths = np.ones(DRAWS)
        if self._walk == "disk":
            lengths = np.sqrt(self._generator.uniform(0.0, 1.0, DRAWS))
        elif self._walk == "persistent" and heading is not None:
            # The others are for where all of these are blocked.
            turns = self._generator.normal(0.0, TURN_STD_RAD, DRAWS // 2)
            drawn[: DRAWS // 2] = heading + turns
        return lengths[:, None] * np.column_stack([np.cos(drawn), np.sin(drawn)])


def _heading(step_m: NDArray[np.float64]) -> float | None:
    """Direction of a step (2,); None of one that stands still."""
    if np.linalg.norm(step_m) <= STANDSTILL_M:
        return None
    return math.atan2(float(step_m[1]), float(step_m[0]))


FEWEST_LANES = 3
"""A fit may find a decorrelation distance beyond all that was measured."""


class LawnmowerPlanner:
    """Sweeps one robot of a problem over its workspace; remembers how far it is."""

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem, self._ground = problem, ground
        self._tour: NDArray[np.intp] | None = None
        self._stops_m: NDArray[np.float64] = np.empty((0, 2))
        self._next = 0

    def plan(self, situation: StepContext, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is; arguments as of the horizon planner, `warm` is not used.

        The first plan begins the tour, and so does one from a place off it; once it is over, the
        robot stands.
        """
        begun = perf_counter()
        here = situation.position_m
        ahead = self._stops_m[self._next :]
        away = np.linalg.norm(ahead - here, axis=1)
        if self._tour is None or not (away <= STANDSTILL_M).any():
            self._begin(here, situation)
        else:
            self._next += int(np.argmax(away <= STANDSTILL_M))
        horizon = self._problem.planner.horizon
        path = self._stops_m[self._next + 1 : self._next + 1 + horizon]
        return released(judge, held(situation, list(path)), begun)

    def _begin(self, here_m: NDArray[np.float64], situation: StepContext) -> None:
        """Lay the stops of the whole tour, or of what is left of it, from `here_m` (2,)."""
        road_map = self._ground.road_map
        nodes, lengths = first_moves(self._ground, self._problem, here_m)
        if not len(nodes):
            self._stops_m, self._next = here_m[None], 0
            return
        first = int(nodes[np.argmin(lengths)])
        apart = min(station.parameters.decorrelation_m for station in situation.stations)
        self._tour = lawn_tour(road_map, first, apart)
        longest = self._problem.step_length_m - STEP_PAD_M
        corners = np.vstack([here_m, road_map.nodes_m[self._tour]])
        self._stops_m, self._next = stops_along(corners, longest), 0


def lawn_tour(road_map: RoadMap, first: int, apart_m: float) -> NDArray[np.intp]:
    """Nodes from `first` on to and fro over all that can be come to; each next one a move away.

    Lanes are about `apart_m` apart, as near as rows of nodes allow.
    """
    tour = [first]
    low, high = int(road_map.rows.min()), int(road_map.rows.max())
    lanes = lane_rows(low, high, apart_m / road_map.lattice.spacing_m)
    # From the nearer side on.
    if road_map.rows[first] - low > high - road_map.rows[first]:
        lanes.reverse()
    middle = 0.5 * (road_map.columns.min() + road_map.columns.max())
    rightward = bool(road_map.columns[first] <= middle)
    for row in lanes:
        lane = np.flatnonzero(road_map.rows == row)
        lane = lane[np.argsort(road_map.columns[lane])]
        for node in map(int, lane if rightward else lane[::-1]):
            if node != tour[-1]:
                tour += _way(road_map, tour[-1], node)
        rightward = not rightward
    return np.asarray(tour, dtype=np.intp)


def lane_rows(low: int, high: int, apart: float) -> list[int]:
    """Rows of lanes about `apart` rows apart, half of that from the first and the last row."""
    rows = high - low + 1
    count = min(max(math.ceil(rows / apart), FEWEST_LANES), rows)
    middles = low + (np.arange(count) + 0.5) * rows / count - 0.5
    return [int(row) for row in np.rint(middles)]


def _way(road_map: RoadMap, here: int, there: int) -> list[int]:
    """Nodes after `here` up to `there`; none if it cannot be come to."""
    moves = road_map.edge_to[road_map.edge_start[here] : road_map.edge_start[here + 1]]
    if there in moves:
        return [there]
    way = route_from(road_map, lattice_paths(road_map, there), here, math.inf)
    return [int(node) for node in way[1:]] if way[-1] == there else []


EDGE_STD_DB = 0.1
"""Deviation of power at the edge of a disc: connection is certain or ruled out but for a rim of
about one hundredth of its radius, in which a solver has a slope."""

CERTAIN_DB = 300.0
"""So much above any threshold no packet is lost."""

Assumed = Callable[[ChannelParameters], ChannelParameters]


def path_loss_only(parameters: ChannelParameters) -> ChannelParameters:
    """Return the channel as it is, of which nothing has been measured: path loss is all."""
    return parameters


def informed_disk(parameters: ChannelParameters) -> ChannelParameters:
    """Return a channel of path loss alone: connected within a disc, and not beyond."""
    return replace(parameters, shadow_std_db=0.0, multipath_std_db=EDGE_STD_DB)


def unaware(parameters: ChannelParameters) -> ChannelParameters:
    """Return a channel that loses no packet."""
    return replace(parameters, k_pl_db=parameters.k_pl_db + CERTAIN_DB)


def require_tracking(problem: Problem) -> None:
    """Raise an InputError unless a problem tracks a target for one station."""
    if not any(term.sensor for term in problem.terms) or len(problem.stations) > 1:
        raise InputError(
            f"is {problem.planner.name}, which tracks a target for one station",
            file=problem.file,
            key="planner.name",
            remedy="use auto",
        )


class StrategyPlanner:
    """Plans for one robot that tracks a target, on a channel that it assumes."""

    def __init__(self, problem: Problem, ground: Ground, assumed: Assumed) -> None:
        require_tracking(problem)
        self._problem, self._ground, self._assumed = problem, ground, assumed
        inner = replace(problem, planner=replace(problem.planner, name="auto"))
        self._planner = HorizonPlanner(inner, ground)

    def plan(self, situation: StepContext, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is; arguments as of the horizon planner."""
        begun = perf_counter()
        believed = situation.posterior
        k_pl_db, n_pl = (float(value) for value in believed.theta)
        parameters = replace(believed.parameters, k_pl_db=k_pl_db, n_pl=n_pl)
        nothing = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=np.bool_))
        channel = condition(self._assumed(parameters), nothing, theta="known")
        path = self._home(situation) if self._assumed is informed_disk else None
        if path is None:
            # Whoever assumes a channel has learned nothing of it on the run either.
            seen = replace(situation, posteriors=(channel,), uncertain=None, history=BEGINNING)
            assuming = replace(judge, context=seen, objective=ObjectiveValue(seen))
            path = self._planner.plan(seen, assuming, warm).positions_m[1:]
        return released(judge, path, begun)

    def _home(self, situation: StepContext) -> NDArray[np.float64] | None:
        """The shortest path (N, 2) towards the station; None if the disc is within reach."""
        believed, station = situation.posterior, self._problem.stations[0]
        k_pl_db, n_pl = believed.theta
        slant = 10.0 ** ((k_pl_db - station.threshold_dbm) / (10.0 * n_pl))
        radius = np.sqrt(max(slant**2 - station.height_m**2, 0.0))
        base, here = np.asarray(station.position_m), situation.position_m
        horizon, longest = self._problem.planner.horizon, self._problem.step_length_m - STEP_PAD_M
        if np.linalg.norm(base - here) <= radius + horizon * longest:
            return None
        nodes = self._ground.road_map.nodes_m
        ways = WaysFrom(self._problem, self._ground, here)
        away = np.where(np.isfinite(ways.length_m), np.linalg.norm(nodes - base, axis=1), np.inf)
        nearest = int(away.argmin())
        stops = stops_along(ways.turns_m(nearest, nodes[nearest]), longest)[1:]
        return np.concatenate([stops, np.repeat(stops[-1:], horizon, axis=0)])[:horizon]


KEY = "planner.name"


class Planner(Protocol):
    """Plans for one robot of a problem whose objective is a sum of terms."""

    def plan(self, situation: StepContext, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is."""
        ...


def planner_for(problem: Problem, ground: Ground, generator: np.random.Generator) -> Planner:
    """The planner that `problem.planner.name` names."""
    kind = planner_kind(problem.planner.name)
    if kind.foresees:
        raise InputError(
            f"is {kind.name}, a bound that knows the ground truth of a whole run",
            file=problem.file,
            key="planner.name",
            remedy="simulate or compare with it, or name another planner",
        )
    make = kind.maker()
    with calling(make, "", key=KEY, remedy="take a problem, its geometry and a random generator"):
        made = make(problem, ground, generator)
    if not callable(getattr(made, "plan", None)):
        raise InputError(
            f"is {kind.name}: {class_name(made)} has no method plan",
            key=KEY,
            remedy="define plan(self, situation, judge, warm=None), which returns released(...)",
        )
    return made


def asked_plan(
    planner: Planner, situation: StepContext, judge: Judge, warm: Plan | None = None
) -> Plan:
    """Return what a planner plans; see :meth:`Planner.plan`."""
    remedy = "return released(judge, path_m, begun_s), of a path (N, 2)"
    with calling(planner, "plan", key=KEY, remedy=remedy):
        plan = planner.plan(situation, judge, warm)
    part_of(f"{KEY}: what {class_name(planner)}.plan returned", plan, Plan, remedy)
    return plan


def horizon_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the planner that searches, refines and verifies over a horizon."""
    return HorizonPlanner(problem, ground)


def one_step_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the baseline that looks one step ahead."""
    return OneStepPlanner(problem, ground)


def largest_deviation_planner(
    problem: Problem, ground: Ground, _generator: np.random.Generator
) -> Planner:
    """Make the baseline that goes where power is known least within a step."""
    return OneStepPlanner(problem, ground, end_deviation)


def random_planner(problem: Problem, ground: Ground, generator: np.random.Generator) -> Planner:
    """Make the baseline that walks full steps in random directions."""
    return RandomPlanner(problem, ground, generator)


def disk_walk_planner(problem: Problem, ground: Ground, generator: np.random.Generator) -> Planner:
    """Make the baseline whose steps are uniform over the disc of one step."""
    return RandomPlanner(problem, ground, generator, "disk")


def persistent_walk_planner(
    problem: Problem, ground: Ground, generator: np.random.Generator
) -> Planner:
    """Make the baseline that walks full steps and turns little."""
    return RandomPlanner(problem, ground, generator, "persistent")


def lawnmower_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the baseline that mows the workspace."""
    return LawnmowerPlanner(problem, ground)


def path_loss_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the strategy that knows path loss, and nothing of shadowing."""
    return StrategyPlanner(problem, ground, path_loss_only)


def disk_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the strategy that counts on all packets within a disc, and on none beyond."""
    return StrategyPlanner(problem, ground, informed_disk)


def unaware_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the strategy that counts on all packets everywhere."""
    return StrategyPlanner(problem, ground, unaware)
