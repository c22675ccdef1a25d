"""Lower bounds on the cost of every route to a goal, by duality.

A metre at x costs ``w(x) = 1 + price (1 - P(x))`` metres. Every function V with ``|grad V| <= w``
in the free space and ``V <= 0`` at the goal proves that every route costs at least V(start):
integrate the gradient along it (theorem 6.14). V is quadratic on the triangles of a
mesh and continuous, so that its gradient is linear on each, and ``|grad V|`` is convex. With w
replaced by a certified linear lower bound, the three corners of a triangle suffice. The best V
solves a second-order cone programme. It is divided by its largest violation, so that the bound
holds whatever the solver's tolerance. The mesh is refined where the flow that is dual to V is
strong.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from time import monotonic
from typing import Any

import numpy as np
import shapely
from scipy import sparse

from planopt.arrays import Floats, Indices, Mask
from planopt.bounds.bound import Potential
from planopt.bounds.enclosure import ROUNDING, PowerEnclosure
from planopt.bounds.mesh import (
    Corridor,
    Mesh,
    covers_bounds,
    doubled_areas,
    enclosing_discs,
    first_mesh,
    sides_of,
)
from planopt.channel.posterior import ChannelPosterior
from planopt.world.clearance import polygons_of
from planopt.world.shortest_paths import INNER_SHARE

FIRST_TRIANGLES = 5_000, 200
"""Number of triangles added to the corridor of good routes before the first solve: a constant, and
a number per second of available time."""
FIRST_SOLVE_S = 4.0
"""Minimum time limit of the first solve in seconds; it usually takes less than half a second."""
GROWTH = 1.8  # Largest ratio of the numbers of triangles in successive solves
MAX_TRIANGLES = 60_000  # Maximum number of triangles; a solve then takes about a minute
LOOSE_SHARE = 0.01
"""Relative gap between certified and actual cost above which corridor triangles are refined."""
CORRIDORS = 0.05, 0.03, 0.02, 0.01, 0.01, 0.01, 0.01, 0.01, 0.01
"""Maximum relative excess cost of routes through the corridor, for each of its refinements."""
MESH_SHARE = 3e-4  # Largest area of a triangle in the corridor, as a share of the workspace
FLOW_WEIGHT = 0.005  # Expected relative gain of refining a triangle whose certified cost is exact
SCORE_SHARE = 0.95
"""Share of the total expected gain that the triangles selected for refinement make up."""
FRAME_SHARE = 0.02
"""Width of the blocked frame around the workspace, as a share of the workspace diagonal."""
ROUTE_TOLERANCE_M = 1e-5
"""Tolerance of the verifier, by which obstacles are grown less than the clearance."""
SOLVER_TOLERANCE = 3e-4
"""Relative gap of the solver. It affects the tightness of the bound, never its validity."""
EPSILON = 32.0 * np.finfo(float).eps  # Relative rounding error of a gradient


@dataclass(frozen=True)
class RouteProblem:
    """Problem of the cheapest route from a start to a goal disc in free space."""

    bounds_m: tuple[float, float, float, float]
    obstacles: Sequence[shapely.Polygon]
    clearance_m: float  # Negative: depth by which routes may cut into obstacles
    start_m: Floats  # (2,)
    goal_m: Floats  # (2,)
    goal_radius_m: float
    price: float  # Cost of a metre out of contact, in metres
    free_above: float  # P(connected) from which on outage is free; above 1: never
    posteriors: Sequence[ChannelPosterior]  # One per station
    thresholds_dbm: Sequence[float]


@dataclass(frozen=True)
class RouteBound:
    """A certified lower bound on the cost of every route."""

    value_m: float
    potential: Potential | None  # None for the straight-line distance
    corridor: Corridor | None = None  # Cheapest paths through the latest mesh


def route_bounds(problem: RouteProblem, seconds: float) -> Iterator[RouteBound]:
    """Yield ever larger certified lower bounds of the route cost for some wall time."""
    # The first solve may exceed the time; later solves are interrupted.
    begun = monotonic()
    straight = float(np.linalg.norm(problem.goal_m - problem.start_m)) - problem.goal_radius_m
    best = RouteBound(max(0.0, straight) * (1.0 - ROUNDING), None)
    yield best
    blocked = blocked_areas(problem)
    if not blocked.reaches_goal:
        return
    mesh = first_mesh(
        *(problem.bounds_m, blocked.parts, problem.start_m, problem.goal_m, problem.goal_radius_m)
    )
    powers = [PowerEnclosure(posterior) for posterior in problem.posteriors]
    most_area = MESH_SHARE * float(np.prod(np.subtract(*np.reshape(problem.bounds_m, (2, 2)))))
    widths, first = list(CORRIDORS), 0
    while True:
        turn = monotonic()
        corners = mesh.triangles()
        is_open, cost, middle = _known_costs(problem, blocked, powers, mesh, corners)
        inner = corners[is_open]
        loose = 1.0 - cost.mean(axis=1) / middle
        if widths and monotonic() - begun < 0.4 * seconds:
            # The flow of the programme takes the triangles whose bounds of the cost are low.
            low = Corridor(mesh.nodes_m, inner, cost.mean(axis=1), problem.goal_m)
            chosen = low.excess < widths.pop(0)
            area = np.abs(doubled_areas(mesh.nodes_m, inner)) / 2.0
            chosen &= (loose > LOOSE_SHARE) | (area > most_area)
            first = first or len(inner)
            room = round(first + FIRST_TRIANGLES[0] + FIRST_TRIANGLES[1] * seconds) - len(inner)
            loss = loose * middle * np.sqrt(area)
            if room > 0 and mesh.refine(_largest(loss, inner, chosen, room)):
                continue
        corridor = Corridor(mesh.nodes_m, inner, middle, problem.goal_m)
        if not corridor.is_connected:
            return
        best = replace(best, corridor=corridor)
        yield best
        left = seconds - (monotonic() - begun)
        if best.potential is not None and left <= 0.0:
            return
        at_goal = _touches_goal(problem, mesh.nodes_m, inner)
        limit_s = max(left, FIRST_SOLVE_S if best.potential is None else 0.1)
        potential, flow = _best_potential(mesh.nodes_m, corners, is_open, cost, at_goal, limit_s)
        potential = _scaled(potential, is_open, cost, at_goal)
        value = proven_value(potential)
        covered = covers_bounds(mesh.nodes_m, corners, problem.bounds_m)
        elapsed = monotonic() - begun
        if covered and value > best.value_m:
            best = RouteBound(value, potential, corridor)
            yield best
        widths.clear()
        left = seconds - (monotonic() - begun)
        # The time of an iteration grows with about the 1.3rd power of the number of triangles.
        growth = min(GROWTH, (0.8 * max(left, 0.0) / (elapsed - turn + begun)) ** (1.0 / 1.3))
        room = min(growth * len(inner), MAX_TRIANGLES) - len(inner)
        if room < 0.02 * len(inner):
            return
        gain = (flow[:, None] * (middle[:, None] * (1.0 + FLOW_WEIGHT) - cost)).sum(axis=1)
        mesh.refine(inner[_refined(inner, gain, loose, round(room / 3.0), len(mesh.nodes_m))])


def _refined(corners: Indices, gain: Floats, loose: Floats, count: int, nodes: int) -> Indices:
    """Return about `count` triangles to refine: first by gain, then loose ones nearby."""
    order = np.argsort(-gain)
    reached = np.cumsum(gain[order]) < SCORE_SHARE * float(gain.sum())
    enough = int(np.count_nonzero(reached)) + 1
    strong = order[: min(enough, max(1, count))]
    near = np.zeros(nodes, dtype=bool)
    near[corners[strong]] = True
    adjacent = near[corners].any(axis=1) & (loose > LOOSE_SHARE)
    adjacent[strong] = False
    others = np.flatnonzero(adjacent)
    others = others[np.argsort(-loose[others])]
    return np.concatenate([strong, others[: max(0, count - len(strong))]])


def proven_value(potential: Potential | None) -> float:
    """Return the bound in metres that a valid potential proves; 0 without one."""
    return 0.0 if potential is None else float(potential.at_nodes[0]) * (1.0 - ROUNDING)


def valid_potential(problem: RouteProblem, potential: Potential) -> Potential | None:
    """Return a saved potential, scaled until it satisfies (6.14); None if it is unusable."""
    nodes_m, corners = potential.nodes_m, potential.corners
    arrays = (nodes_m, potential.at_nodes, potential.at_sides)
    is_whole = (
        all(np.isfinite(array).all() for array in arrays)
        and corners.min(initial=0) >= 0
        and corners.max(initial=0) < len(nodes_m)
        and (np.diff(corners, axis=1) > 0).all()
        and len(potential.at_nodes) == len(nodes_m)
        and len(potential.at_sides) == len(np.unique(sides_of(corners), axis=0))
        and np.array_equal(nodes_m[0], problem.start_m)
        and covers_bounds(nodes_m, corners, problem.bounds_m)
    )
    blocked = blocked_areas(problem)
    if not is_whole or not blocked.reaches_goal:
        return None
    is_open = blocked.is_open(nodes_m, corners)
    powers = [PowerEnclosure(posterior) for posterior in problem.posteriors]
    cost, _ = metre_costs(problem, powers, nodes_m[corners[is_open]])
    at_goal = _touches_goal(problem, nodes_m, corners[is_open])
    return _scaled(potential, is_open, cost, at_goal)


@dataclass(frozen=True, eq=False)
class BlockedAreas:
    """Areas that no route enters: grown obstacles, and free space unreachable from the start."""

    parts: Sequence[shapely.Polygon]
    tree: shapely.STRtree
    reaches_goal: bool  # Whether the goal is reachable from the start

    def is_open(self, nodes_m: Floats, corners: Indices) -> Mask:
        """Return a mask (t,) of the triangles (t, 3) that are not inside a blocked area."""
        inside, _ = self.tree.query(shapely.polygons(nodes_m[corners]), predicate="covered_by")
        is_open = np.ones(len(corners), dtype=bool)
        is_open[inside] = False
        return is_open


def blocked_areas(problem: RouteProblem) -> BlockedAreas:
    """Return the areas that no route of a route problem enters."""
    grown = grown_by(problem.obstacles, problem.clearance_m, ROUTE_TOLERANCE_M)
    box = shapely.box(*problem.bounds_m)
    free = shapely.get_parts(box.difference(grown))
    goal = shapely.Point(problem.goal_m).buffer(_outer_radius_m(problem), quad_segs=64)
    own = [part for part in free if part.intersects(shapely.Point(problem.start_m))]
    # The frame closes gaps between the workspace boundary and obstacles that touch it.
    x0, y0, x1, y1 = problem.bounds_m
    width = FRAME_SHARE * float(np.hypot(x1 - x0, y1 - y0))
    frame = shapely.box(x0 - width, y0 - width, x1 + width, y1 + width)
    parts = polygons_of(frame.difference(shapely.union_all(own)))
    reaches = any(part.intersects(goal) for part in own)
    return BlockedAreas(parts, shapely.STRtree(parts), reaches)


def grown_by(
    obstacles: Sequence[shapely.Polygon], clearance_m: float, tolerance_m: float
) -> shapely.Geometry:
    """Return obstacles grown by at most the clearance less a tolerance; not by less than zero."""
    if clearance_m > 0.0:
        # GEOS grows polygons by up to a hundredth too much. Contact is a collision in any case.
        clearance_m = max(0.0, clearance_m * INNER_SHARE - tolerance_m)
    return shapely.union_all([polygon.buffer(clearance_m) for polygon in obstacles])


def _outer_radius_m(problem: RouteProblem) -> float:
    """Return the distance from the goal to the corners of a 256-gon around the goal's disc."""
    return problem.goal_radius_m / float(np.cos(np.pi / 256)) + ROUTE_TOLERANCE_M


def _touches_goal(problem: RouteProblem, nodes_m: Floats, corners: Indices) -> Mask:
    """Return a mask (t,) of the triangles that touch the goal's disc."""
    goal = shapely.Point(problem.goal_m).buffer(_outer_radius_m(problem), quad_segs=64)
    shapely.prepare(goal)
    return np.asarray(shapely.intersects(goal, shapely.polygons(nodes_m[corners])), dtype=bool)


def _largest(loss: Floats, corners: Indices, chosen: Mask, room: int) -> Indices:
    """Return the chosen triangles of most loss whose refinement adds at most `room` triangles."""
    order = np.lexsort([-loss, ~chosen])
    return corners[order[: min(int(chosen.sum()), max(1, room // 3))]]


def _known_costs(
    problem: RouteProblem,
    blocked: BlockedAreas,
    powers: Sequence[PowerEnclosure],
    mesh: Mesh,
    corners: Indices,
) -> tuple[Mask, Floats, Floats]:
    """Return a mask (t,) of the open triangles, and their cached :func:`metre_costs`."""
    keys = [tuple(row) for row in corners.tolist()]
    new = np.array([k for k, key in enumerate(keys) if key not in mesh.known], dtype=np.intp)
    if len(new):
        is_open = blocked.is_open(mesh.nodes_m, corners[new])
        least, middle = metre_costs(problem, powers, mesh.nodes_m[corners[new[is_open]]])
        for k in new[~is_open].tolist():
            mesh.known[keys[k]] = None
        found = zip(new[is_open].tolist(), least.tolist(), middle.tolist(), strict=True)
        for k, row, centre in found:
            mesh.known[keys[k]] = (*row, centre)
    known = [mesh.known[key] for key in keys]
    costs = np.array([each for each in known if each is not None]).reshape(-1, 4)
    return np.array([each is not None for each in known]), costs[:, :3], costs[:, 3]


def metre_costs(
    problem: RouteProblem, powers: Sequence[PowerEnclosure], corners_m: Floats
) -> tuple[Floats, Floats]:
    """Return lower bounds (t, 3) of the cost per metre at corners, and costs (t,) at centres."""
    count = len(corners_m)
    if problem.price == 0.0:
        return np.ones((count, 3)), np.ones(count)
    centre, radius = enclosing_discs(corners_m)
    offset = corners_m - centre[:, None]
    silent, at_centre = np.ones((count, 3)), np.ones(count)
    for power, threshold in zip(powers, problem.thresholds_dbm, strict=True):
        model = power.over(centre, radius)
        own = 1.0 - model.probability_above(threshold, offset)
        silent = _product_below(silent, np.where(own.min(axis=1)[:, None] < 0.0, 0.0, own))
        at_centre *= 1.0 - model.probability(threshold)
    silent[~(1.0 - silent.min(axis=1) < problem.free_above)] = 0.0
    at_centre[1.0 - at_centre >= problem.free_above] = 0.0
    # An undefined enclosure, of a triangle without area, certifies nothing.
    silent = np.nan_to_num(silent, nan=0.0, posinf=0.0, neginf=0.0)
    return 1.0 + problem.price * silent, 1.0 + problem.price * at_centre


def _product_below(one: Floats, other: Floats) -> Floats:
    """Return corner values (t, 3) of a linear lower bound on a product of linear functions >= 0."""
    # The product is at least its interpolation minus a quarter of the sum, over the sides, of the
    # positive products of both functions' differences.
    product = one * other
    following = [1, 2, 0]
    across = (one - one[:, following]) * (other - other[:, following])
    return np.maximum(product - 0.25 * np.maximum(across, 0.0).sum(axis=1)[:, None], 0.0)


def _best_potential(
    nodes_m: Floats, corners: Indices, is_open: Mask, cost: Floats, at_goal: Mask, limit_s: float
) -> tuple[Potential, Floats]:
    """Return the potential with the largest value at the start, and the dual flow (t,)."""
    import clarabel

    # The module has no type information.
    solvers: Any = clarabel
    unknown, slope_x, slope_y = slopes_of(nodes_m, corners)
    sides = int(unknown.max()) + 1 - len(nodes_m)
    unknown, slope_x, slope_y = unknown[is_open], slope_x[is_open], slope_y[is_open]
    free = np.setdiff1d(unknown, unknown[at_goal])
    number = np.full(len(nodes_m) + sides, -1)
    number[free] = np.arange(len(free))
    count = 3 * len(unknown)
    potential = np.zeros(len(number))
    flow = np.zeros(len(unknown))
    if number[0] >= 0:
        # One cone (w, dV/dx, dV/dy) for each corner of each triangle.
        row = np.repeat(np.arange(count), 6)
        column = number[np.repeat(unknown, 3, axis=0)].ravel()
        kept = column >= 0
        row, column = row[kept], column[kept]
        values = np.concatenate([-slope_x.reshape(-1)[kept], -slope_y.reshape(-1)[kept]])
        places = (np.concatenate([3 * row + 1, 3 * row + 2]), np.tile(column, 2))
        matrix = sparse.csc_matrix((values, places), shape=(3 * count, len(free)))
        limits = np.zeros(3 * count)
        limits[::3] = cost.ravel()
        aim = np.zeros(len(free))
        aim[number[0]] = -1.0
        settings = solvers.DefaultSettings()
        settings.verbose = False
        settings.time_limit = limit_s
        settings.tol_gap_rel = settings.tol_gap_abs = settings.tol_feas = SOLVER_TOLERANCE
        cones: list[Any] = [solvers.SecondOrderConeT(3)] * count
        nothing = sparse.csc_matrix((len(free), len(free)))
        solver = solvers.DefaultSolver(nothing, aim, matrix, limits, cones, settings)
        solution = solver.solve()
        potential[free] = np.nan_to_num(np.asarray(solution.x), posinf=0.0, neginf=0.0)
        flow = np.nan_to_num(np.asarray(solution.z)[::3]).clip(0.0).reshape(-1, 3).sum(axis=1)
    at_nodes, at_sides = potential[: len(nodes_m)], potential[len(nodes_m) :]
    return Potential(nodes_m, corners, at_nodes, at_sides), flow


def _scaled(potential: Potential, is_open: Mask, cost: Floats, at_goal: Mask) -> Potential:
    """Return a potential shifted and scaled until it satisfies (6.14); zero if that fails."""
    unknown, *slopes = slopes_of(potential.nodes_m, potential.corners)
    values = np.concatenate([potential.at_nodes, potential.at_sides])[unknown[is_open]]
    with np.errstate(all="ignore"):
        parts = [
            np.abs(np.einsum("tcu,tu->tc", part, values))
            + EPSILON * np.einsum("tcu,tu->tc", np.abs(part), np.abs(values))
            for part in (slope[is_open] for slope in slopes)
        ]
        worst = float((np.hypot(*parts) / cost).max())
    # V is at most its largest Bernstein coefficient, at corners and sides.
    ends = values[at_goal][:, [[1, 2], [0, 2], [0, 1]]].sum(axis=2)
    sides = 2.0 * values[at_goal][:, 3:] - 0.5 * ends
    top = float(np.maximum(values[at_goal][:, :3].max(), sides.max()))
    usable = np.isfinite(top) and np.isfinite(worst)
    shift, factor = (top, 1.0 / max(1.0, worst)) if usable else (0.0, 0.0)
    both = [(each - shift) * factor for each in (potential.at_nodes, potential.at_sides)]
    return replace(potential, at_nodes=both[0], at_sides=both[1])


def slopes_of(nodes_m: Floats, corners: Indices) -> tuple[Indices, Floats, Floats]:
    """Return indices (t, 6) of corner and mid-side values, and slopes (t, 3, 6) along x and y."""
    a, b, c = (nodes_m[corners[:, i]] for i in range(3))
    double = doubled_areas(nodes_m, corners)
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.stack([b - c, c - a, a - b], axis=1) / double[:, None, None]
    hat = (sides[:, :, 1], -sides[:, :, 0])  # Gradients of the barycentric coordinates
    share = np.zeros((3, 6, 3))  # Corner, unknown, barycentric coordinate
    for i in range(3):
        for j in range(3):
            share[i, j, j] = 3.0 if i == j else -1.0
            p, q = (j + 1) % 3, (j + 2) % 3
            share[i, 3 + j, p] = 4.0 if i == q else 0.0
            share[i, 3 + j, q] = 4.0 if i == p else 0.0
    slopes = [np.einsum("iuj,tj->tiu", share, part) for part in hat]
    opposite = corners[:, [[1, 2], [0, 2], [0, 1]]].reshape(-1, 2)
    _, number = np.unique(opposite[:, 0] * len(nodes_m) + opposite[:, 1], return_inverse=True)
    unknown = np.column_stack([corners, len(nodes_m) + number.reshape(-1, 3)])
    return unknown, slopes[0], slopes[1]
