"""Initial guesses that lead to one position: probed, unmeasured, or satisfying p_min.

In most directions, lattice paths are slower than the robot, so a search may miss a position that is
only just reachable in time. If the verifier reports that a step could have satisfied p_min,
:func:`paths_to_good_place` searches for such a position and the shortest path to it.
"""

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.channel.kriging import Prediction, connection_probability
from planopt.channel.neighbours import PlaceTree
from planopt.planning.candidates import Candidate, Scorer, held
from planopt.planning.proof.rule import search_prediction
from planopt.planning.scene import Ground, PathsFrom, free_ends, retime, stops_along
from planopt.planning.search.local_ranking import LocalRanking
from planopt.planning.search.node_margins import NodeField
from planopt.planning.tolerances import CLEARANCE_PAD_M, MARGIN_PAD_DB, STEP_PAD_M
from planopt.planning.values.context import StepContext, left_to_learn
from planopt.planning.values.objective_value import probe_values
from planopt.problems.problem import Problem
from planopt.world.clearance import clearance_m, inside_bounds, is_clear, segments_clear
from planopt.world.lattice import REACH_TOLERANCE_M
from planopt.world.shortest_paths import ShortestPaths, path_lengths_m, shortest_paths, turns_m

CIRCLES = (0.35, 0.7, 1.0, 1.5, 2.0, 2.5, 3.25, 4.0, 5.0, 6.0, 7.5, 9.0)
"""Radii of circles of positions, in longest steps."""
FEWEST_ON_CIRCLE, APART_SHARE, LEAST_APART = 8, 1.0 / 6.0, 0.5
"""Minimum number of positions on a circle, and their spacing in radii and in longest steps."""
MOST_KNOWN = 60  # Maximum number of known connected positions, nearest to the expected target first
MOST_HIDDEN = 12  # Maximum number of positions behind obstacles, nearest to the target first
COMPARED = 12  # Number of paths whose ends are predicted individually
PROBED = 4  # Number of returned paths


class ProbedPlaces:
    """Search for paths to positions that one robot may probe."""

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem, self._ground = problem, ground
        self._longest_m = problem.step_length_m - STEP_PAD_M
        self._alone = len(problem.terms) == 1 and not problem.constraints.requires_connection
        places = [np.zeros((1, 2))]
        for number, radius in enumerate(CIRCLES):
            apart = max(LEAST_APART, radius * APART_SHARE)
            count = max(FEWEST_ON_CIRCLE, math.ceil(2.0 * math.pi * radius / apart))
            angle = 2.0 * math.pi * (np.arange(count) + 0.5 * (number % 2)) / count
            places.append(radius * np.column_stack([np.cos(angle), np.sin(angle)]))
        offsets = self._longest_m * np.vstack(places)
        reach_m = problem.planner.horizon * self._longest_m
        self._offsets_m = offsets[np.linalg.norm(offsets, axis=1) <= reach_m]

    def find_paths(self, context: StepContext, field: NodeField) -> list[Floats]:
        """Return the best paths (N, 2) to probe positions, best first."""
        places = self._places(context)
        seen = free_ends(self._problem, self._ground, context.position_m, places)
        seen[0] = True
        routes = [*self._straight(context.position_m, places[seen])]
        routes += self._round(context, places[~seen])
        paths = np.array(routes)
        guessed = self._chance(context, self._near_power(field, paths.reshape(-1, 2)))
        guessed = np.nan_to_num(guessed).reshape(paths.shape[:2])
        kept = self._best(context, paths, guessed, COMPARED)
        paths, guessed = paths[kept], guessed[kept]
        stops = paths[:, -1]
        at_stop = (paths == stops[:, None]).all(axis=2)
        ends = self._chance(context, context.power(stops))
        guessed = np.where(at_stop, ends[:, None], guessed)
        probed = PROBED if self._alone else COMPARED
        return [paths[i] for i in self._best(context, paths, guessed, probed)]

    def _best(self, context: StepContext, paths: Floats, chance: Floats, count: int) -> Indices:
        """Return indices of the best of `paths` (c, N, 2), for probabilities `chance` (c, N)."""
        value = np.zeros(len(paths))
        for number, term in enumerate(context.problem.terms):
            if term.probes_end:
                value += probe_values(context, number, paths, chance)
        missing = np.zeros(len(paths))
        if self._problem.constraints.requires_connection:
            constraints = self._problem.constraints
            each = chance if constraints.rule.by_step else chance.mean(axis=1, keepdims=True)
            missing = np.maximum(constraints.p_min - each, 0.0).sum(axis=1)
        return np.lexsort((-value, np.round(missing, 3)))[:count]

    def _near_power(self, field: NodeField, places_m: Floats) -> Prediction:
        """Return the power at the free node nearest to each position (n, 2)."""
        power = field.nearest(places_m)
        blocked = np.flatnonzero(np.isnan(power.mean_db))
        if len(blocked):
            nodes = self._nodes.nearest(places_m[blocked], 1)[0][:, 0]
            free = field.nearest(self._ground.road_map.nodes_m[nodes])
            power.mean_db[blocked], power.deviation_db[blocked] = free.mean_db, free.deviation_db
        return power

    @cached_property
    def _nodes(self) -> PlaceTree:
        """Return the spatial index of the free nodes."""
        return PlaceTree(self._ground.road_map.nodes_m)

    def _chance(self, context: StepContext, power: Prediction) -> Floats:
        return connection_probability(
            power.mean_db, power.deviation_db, context.law.thresholds_dbm[0]
        )

    def _places(self, context: StepContext) -> Floats:
        """Return the robot's position, positions on circles, and reachable connected positions."""
        here, known = context.position_m, context.connected_m
        circles = here + self._offsets_m
        reach_m = self._problem.planner.horizon * self._longest_m
        known = known[np.linalg.norm(known - here, axis=1) <= reach_m]
        target = context.aim.target_m
        if target is not None and len(known) > MOST_KNOWN:
            away = np.linalg.norm(known[:, None] - target, axis=2).sum(axis=1)
            known = known[np.argsort(away, kind="stable")[:MOST_KNOWN]]
        inside = inside_bounds(self._problem.workspace, circles)
        inside[0] = True
        return np.vstack([circles[inside], known])

    def _straight(self, here_m: Floats, places_m: Floats) -> Floats:
        """Return straight paths (n, N, 2) that reach positions at full speed and wait there."""
        horizon = self._problem.planner.horizon
        away = places_m - here_m
        length = np.linalg.norm(away, axis=1)
        driven = self._longest_m * np.arange(1, horizon + 1)
        share = np.minimum(1.0, driven / np.maximum(length, 1e-12)[:, None])
        routes = here_m + share[..., None] * away[:, None]
        return np.where((share >= 1.0)[..., None], places_m[:, None], routes)

    def _round(self, context: StepContext, hidden_m: Floats) -> list[Floats]:
        """Return paths around obstacles to the positions `hidden_m` (n, 2) nearest the target."""
        target, horizon = context.aim.target_m, self._problem.planner.horizon
        if not len(hidden_m) or target is None:
            return []
        away = np.linalg.norm(hidden_m - target[-1], axis=1)
        hidden_m = hidden_m[np.argsort(away, kind="stable")[:MOST_HIDDEN]]
        reach_m = horizon * self._longest_m
        routes = PathsFrom(self._problem, self._ground, context.position_m, reach_m)
        nodes = self._ground.road_map.nodes_m
        next_to = self._nodes.nearest(hidden_m, 1)[0][:, 0]
        found: list[Floats] = []
        for node in np.unique(next_to[np.isfinite(routes.length_m[next_to])]):
            turns = routes.turns_m(int(node), nodes[node])
            stops = stops_along(turns, self._longest_m)[1:]
            if 0 < len(stops) <= horizon:
                found.append(held(context, list(stops)))
        return found


STEPS_MORE = 2  # Number of steps by which compared positions may be farther than the nearest one


def path_to_unmeasured(context: StepContext, ground: Ground) -> Floats | None:
    """Return the first N steps (N, 2) to an unmeasured position; None if there is none."""
    problem, here = context.problem, context.position_m
    lattice, nodes = ground.road_map.lattice, ground.road_map.nodes_m
    left = left_to_learn(problem, ground.index, lattice, here, context.anticipated)
    if not len(left):
        return None
    routes = PathsFrom(problem, ground, here)
    next_to = PlaceTree(nodes).nearest(left, 1)[0][:, 0]
    longest = problem.step_length_m - STEP_PAD_M
    steps = _steps(routes, left, here, next_to, nodes, longest)
    near = np.flatnonzero(steps <= steps.min() + STEPS_MORE)
    if not np.isfinite(steps[near]).all():
        return None
    single = left[near][:, None]
    best = int(near[(LocalRanking(context, single)(single) / steps[near]).argmax()])
    stops = stops_along(routes.turns_m(int(next_to[best]), left[best]), longest)[1:]
    horizon = problem.planner.horizon
    return np.concatenate([stops, np.repeat(stops[-1:], horizon, axis=0)])[:horizon]


def _steps(
    routes: PathsFrom,
    places_m: Floats,
    here_m: Floats,
    next_to: Indices,
    nodes_m: Floats,
    longest_m: float,
) -> Floats:
    """Return the number (n,) of steps to each position, straight or via its nearest node."""
    aside: Floats = np.linalg.norm(nodes_m[next_to] - places_m, axis=1)
    straight: Floats = np.linalg.norm(places_m - here_m, axis=1)
    length = np.where(routes.straight(places_m), straight, routes.length_m[next_to] + aside)
    return np.maximum(np.ceil(length / longest_m), 1.0)


FINE_NODES, COARSE_NODES = 12, 4
"""Number of grid positions per longest step, within `FINE_STEPS` steps and beyond."""
FINE_STEPS = 4
MEASURED = 400  # Number of best positions for which path lengths are computed
KEPT = 24  # Number of best reachable positions that are refined
STEP_PLACES = 12  # Number of candidate step ends per step length along a path
REFINEMENTS = 3  # Number of grid refinements, each with a quarter of the previous spacing


def paths_to_good_place(scorer: Scorer, probed: Sequence[Candidate]) -> list[Floats]:
    """Return paths (N, 2) to a position that satisfies p_min and is reachable in time."""
    problem, index = scorer.problem, scorer.index
    sound = [candidate for candidate in probed if candidate.sound]
    step = min((step for candidate in sound for step in candidate.avoidable), default=None)
    if step is None:
        return []
    length = problem.step_length_m - STEP_PAD_M
    clear = problem.constraints.clearance_m + CLEARANCE_PAD_M
    bounds = problem.workspace.bounds_m
    routes = shortest_paths(index, bounds, scorer.position_m, clear, step * length, inner=False)
    place = _good_place(scorer, routes, step, clear)
    turns = None if place is None else turns_m(routes, place)
    if turns is None:
        return []
    horizon = problem.planner.horizon
    driven = _padded(_in_fewest_steps(scorer, turns, length), horizon)
    if len(turns) == 1:
        return [driven]
    cutting = retime(scorer.position_m, _padded(turns, max(horizon, len(turns))), turns[:0], length)
    return [driven, cutting[:horizon]]


def _good_place(scorer: Scorer, routes: ShortestPaths, step: int, clear_m: float) -> Floats | None:
    """Return the nearest position (2,) that satisfies p_min, if possible with a pad, or None."""
    nodes = FINE_NODES if step <= FINE_STEPS else COARSE_NODES
    spacing = scorer.problem.step_length_m / nodes
    offsets = spacing * np.arange(-nodes * step, nodes * step + 1)
    places = scorer.position_m + np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    fractions = np.array([-0.5, -0.25, 0.0, 0.25, 0.5])
    around = np.stack(np.meshgrid(fractions, fractions), axis=-1).reshape(1, -1, 2)
    found: list[Floats] = []
    for _ in range(REFINEMENTS + 1):
        places, margins, length = _reached(scorer, routes, places, clear_m)
        if not len(places):
            break
        found.append(np.column_stack([places, margins, length]))
        places = (places[:KEPT, None] + spacing * around).reshape(-1, 2)
        spacing /= 4.0
    if not found:
        return None
    x_y, margins, length = np.split(np.concatenate(found), [2, 3], axis=1)
    best = int(_promise(margins[:, 0], length[:, 0])[0])
    return x_y[best] if margins[best, 0] >= 0.0 else None


def _reached(
    scorer: Scorer, routes: ShortestPaths, places_m: Floats, clear_m: float
) -> tuple[Floats, Floats, Floats]:
    """Return the reachable positions (n, 2), their margins and path lengths, best first."""
    away = np.linalg.norm(places_m - routes.start_m, axis=1)
    places = places_m[(away <= routes.radius_m) & inside_bounds(scorer.problem.workspace, places_m)]
    places = places[is_clear(clearance_m(scorer.index, places), clear_m)]
    if not len(places):
        return places, np.zeros(0), np.zeros(0)
    margins = scorer.margins_db(search_prediction(scorer.context.law, places))
    probed = _promise(margins, np.linalg.norm(places - routes.start_m, axis=1))[:MEASURED]
    length = path_lengths_m(routes, places[probed])
    probed, length = probed[np.isfinite(length)], length[np.isfinite(length)]
    order = _promise(margins[probed], length)
    return places[probed[order]], margins[probed[order]], length[order]


def _promise(margins_db: Floats, length_m: Floats) -> Indices:
    """Return the order of positions: first those that satisfy p_min, by length; then by margin."""
    meets = margins_db >= MARGIN_PAD_DB
    return np.lexsort((np.where(meets, length_m, -margins_db), ~meets))


def _in_fewest_steps(scorer: Scorer, turns_m: Floats, length_m: float) -> Floats:
    """Return the ends (n, 2) of the fewest straight collision-free steps along a path."""
    # A step that ends near a corner can replace several turns around it.
    route = np.vstack([scorer.position_m, turns_m])
    driven = np.concatenate([[0.0], np.linalg.norm(np.diff(route, axis=0), axis=1).cumsum()])
    between = np.arange(0.0, driven[-1], length_m / STEP_PLACES)
    at = np.unique(np.concatenate([driven, between]))
    places = np.stack([np.interp(at, driven, route[:, axis]) for axis in (0, 1)], axis=1)
    next_to, crossed_at = _crossings(route, driven, length_m)
    order = np.argsort(np.concatenate([at, crossed_at]), kind="stable")
    places = np.concatenate([places, next_to])[order]
    steps = np.full(len(places), np.inf)
    steps[0] = 0.0
    came = np.zeros(len(places), dtype=np.intp)
    for here in range(len(places) - 1):
        away = np.linalg.norm(places - places[here], axis=1)
        there = np.flatnonzero((away <= length_m + REACH_TOLERANCE_M) & (steps > steps[here] + 1.0))
        there = there[there > here]
        begin = np.broadcast_to(places[here], (len(there), 2))
        wanted = scorer.problem.constraints.clearance_m
        there = there[segments_clear(scorer.index, begin, places[there], wanted)]
        steps[there], came[there] = steps[here] + 1.0, here
    path = [len(places) - 1]
    while came[path[-1]] > 0:
        path.append(int(came[path[-1]]))
    return places[path[::-1]]


def _crossings(route_m: Floats, driven_m: Floats, length_m: float) -> tuple[Floats, Floats]:
    """Return intersections of pairs of extended legs, and path lengths midway between the legs."""
    legs = np.diff(route_m, axis=0)
    places, along = [np.zeros((0, 2))], [np.zeros(0)]
    for one in range(len(legs)):
        for other in range(one + 2, len(legs)):
            if driven_m[other] - driven_m[one + 1] > length_m:
                break
            cross = legs[one, 0] * legs[other, 1] - legs[one, 1] * legs[other, 0]
            gap = route_m[other] - route_m[one + 1]
            if abs(cross) < 1e-9 * np.linalg.norm(legs[one]) * np.linalg.norm(legs[other]):
                continue
            on = (gap[0] * legs[other, 1] - gap[1] * legs[other, 0]) / cross
            back = (gap[0] * legs[one, 1] - gap[1] * legs[one, 0]) / cross
            if on > 0.0 > back:
                places.append((route_m[one + 1] + on * legs[one])[None])
                along.append(np.array([0.5 * (driven_m[one + 1] + driven_m[other])]))
    return np.concatenate(places), np.concatenate(along)


def _padded(path_m: Floats, count: int) -> Floats:
    """Return a path shortened to `count` positions, or extended by repeating its end."""
    return path_m[np.minimum(np.arange(count), len(path_m) - 1)]
