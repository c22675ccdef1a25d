"""Convex safe sets, in which agents move independently of each other: cells and corridors.

The braking path of an agent is always inside both, so an agent can stop regardless of the others.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import shapely
from scipy.spatial import Delaunay, KDTree, QhullError

from planopt.arrays import Floats, Indices, Mask
from planopt.coverage.geodesic import Ground, polygon_boundaries
from planopt.coverage.ground import ConvexGround
from planopt.coverage.voronoi import FAR, ON_BORDER
from planopt.errors import InputError

SPARE = 1e-3  # Extra margin, as a share of the body radius, for rounding and solver tolerances
TOUCHES = 1e-9
"""Distance, relative to the region's radius, up to which a boundary counts as touching a seed."""
LOOKS = 36  # Number of directions in which `SafeSets.thinned` keeps the nearest half-planes
NEARLY = 1.05
"""Half-planes up to this multiple of the nearest one's distance in a direction are kept."""


@dataclass(frozen=True, eq=False)
class SafeSets:
    """Convex set of each agent: an intersection of half-planes and discs."""

    agent: Indices  # (k,) agent of each half-plane
    normals: Floats  # (k, 2) outward unit normals; a half-plane is {q : normal @ q <= offset}
    offsets_m: Floats
    disc_agent: Indices  # (l,) agent of each disc
    centres_m: Floats  # (l, 2); radii_m (l,)
    radii_m: Floats

    def share_inside(self, starts_m: Floats, ends_m: Floats) -> Floats:
        """Return the fraction (n,) of each line before it first leaves the agent's set."""
        # The starts count as inside.
        share = np.ones(len(starts_m))
        move = ends_m - starts_m
        rise = (self.normals * move[self.agent]).sum(axis=1)
        room = self.offsets_m - (self.normals * starts_m[self.agent]).sum(axis=1)
        out = rise > np.maximum(room, 0.0)
        np.minimum.at(share, self.agent[out], np.maximum(room[out], 0.0) / rise[out])
        away, along = starts_m[self.disc_agent] - self.centres_m, move[self.disc_agent]
        square, middle = (along * along).sum(axis=1), (away * along).sum(axis=1)
        spare = np.maximum(self.radii_m**2 - (away * away).sum(axis=1), 0.0)
        out = square + 2.0 * middle > spare
        half = np.asarray(middle[out])
        root = np.sqrt(half * half + square[out] * spare[out])
        # Positive root of square t^2 + 2 half t = spare without cancellation.
        ahead = np.asarray(spare[out] / np.where(half > 0.0, half + root, 1.0), dtype=np.float64)
        behind = np.asarray((root - half) / square[out], dtype=np.float64)
        np.minimum.at(share, self.disc_agent[out], np.where(half > 0.0, ahead, behind))
        return share

    def holds(self, places_m: Floats, slack_m: float = 0.0) -> Mask:
        """Return a mask (n,) of the agents whose positions (n, j, 2) are all in their set."""
        inside = np.ones(len(places_m), dtype=np.bool_)
        height = np.einsum("kjx,kx->kj", places_m[self.agent], self.normals).max(axis=1)
        inside[self.agent[height > self.offsets_m + slack_m]] = False
        away = np.linalg.norm(places_m[self.disc_agent] - self.centres_m[:, None], axis=2)
        inside[self.disc_agent[away.max(axis=1) > self.radii_m + slack_m]] = False
        return inside

    def widened(self, places_m: Floats) -> SafeSets:
        """Return the sets relaxed just enough to contain positions ``(n, j, 2)``."""
        height = np.einsum("kjx,kx->kj", places_m[self.agent], self.normals).max(axis=1)
        away = np.linalg.norm(places_m[self.disc_agent] - self.centres_m[:, None], axis=2)
        offsets = np.maximum(self.offsets_m, height)
        radii = np.maximum(self.radii_m, away.max(axis=1))
        return replace(self, offsets_m=offsets, radii_m=radii)

    def thinned(self, starts_m: Floats, reach_m: Floats) -> SafeSets:
        """Return the sets without half-planes that barely restrict moves from starts ``(n, 2)``."""
        # The result serves planning only; moves are checked against all sets.
        turn = np.linspace(0.0, 2.0 * np.pi, LOOKS, endpoint=False)
        slope = self.normals @ np.stack((np.cos(turn), np.sin(turn)))
        room = np.maximum(self.offsets_m - (self.normals * starts_m[self.agent]).sum(axis=1), 0.0)
        ahead = slope > 1e-9
        view = np.where(ahead, room[:, None] / np.where(ahead, slope, 1.0), np.inf)
        first = np.repeat(reach_m[:, None], LOOKS, axis=1)
        np.minimum.at(first, self.agent, view)
        kept = (view <= NEARLY * first[self.agent]).any(axis=1)
        agent, normals, offsets = self.agent[kept], self.normals[kept], self.offsets_m[kept]
        return replace(self, agent=agent, normals=normals, offsets_m=offsets)

    def of(self, chosen: Indices) -> SafeSets:
        """Return the sets of selected agents, renumbered in the order of `chosen`."""
        largest = max(one.max(initial=0) for one in (self.agent, self.disc_agent, chosen))
        number = np.full(largest + 1, -1)
        number[chosen] = np.arange(len(chosen))
        mine, disc = number[self.agent] >= 0, number[self.disc_agent] >= 0
        return SafeSets(
            number[self.agent[mine]],
            self.normals[mine],
            self.offsets_m[mine],
            number[self.disc_agent[disc]],
            self.centres_m[disc],
            self.radii_m[disc],
        )


def joined(*sets: SafeSets) -> SafeSets:
    """Return the intersection of several sets for each agent."""
    names = [each.name for each in fields(SafeSets)]
    return SafeSets(*(np.concatenate([getattr(one, name) for one in sets]) for name in names))


def half_planes(agent: Indices, normals: Floats, offsets_m: Floats) -> SafeSets:
    """Return sets that consist of half-planes only."""
    return SafeSets(agent, normals, offsets_m, NOBODY, np.zeros((0, 2)), np.zeros(0))


NOBODY = np.zeros(0, dtype=np.intp)
UNBOUNDED = half_planes(NOBODY, np.zeros((0, 2)), np.zeros(0))  # Sets without constraints


def separate_cells(
    places_m: Floats, stops_m: Floats, body_radius_m: float, reach_m: Floats
) -> SafeSets:
    """Return disjoint convex cells of the agents, inset by the body radius."""
    # The separating line is halfway between the nearest points of two reserves. For agents that
    # stop instantly it is the bisector, and the cell is the Voronoi cell.
    # Shapes: places_m, stops_m (n, 2); reach_m (n,).
    if body_radius_m == 0.0 or len(places_m) < 2:
        return UNBOUNDED
    pairs = _neighbours(places_m)
    if not np.array_equal(places_m, stops_m):
        # Add pairs whose reachable sets in a step, including present reserves, overlap.
        middle = 0.5 * (places_m + stops_m)
        wide = reach_m + 0.5 * np.linalg.norm(stops_m - places_m, axis=1) + body_radius_m
        near = KDTree(middle).query_pairs(2.0 * float(wide.max()), output_type="ndarray")
        apart = np.linalg.norm(middle[near[:, 0]] - middle[near[:, 1]], axis=1)
        near = near[apart <= wide[near].sum(axis=1)]
        pairs = np.unique(np.concatenate((pairs, near)), axis=0)
    one, other = pairs[:, 0], pairs[:, 1]
    here, there = closest_points(
        np.stack((places_m[one], stops_m[one]), axis=1),
        np.stack((places_m[other], stops_m[other]), axis=1),
    )
    link = there - here
    gap = np.linalg.norm(link, axis=1)
    if (gap <= 2.0 * body_radius_m).any():
        worst = int(gap.argmin())
        raise InputError(
            f"agents {one[worst]} and {other[worst]} overlap: their centres are {gap[worst]:g} "
            f"m apart, less than the body diameter of {2.0 * body_radius_m:g} m",
            key="agents",
            remedy="place them farther apart, or give a smaller agents.body_radius_m",
        )
    normal = link / gap[:, None]
    middle = (normal * (0.5 * (here + there))).sum(axis=1)
    inset = np.minimum((1.0 + SPARE) * body_radius_m, 0.5 * gap)
    return half_planes(
        np.concatenate((one, other)),
        np.concatenate((normal, -normal)),
        np.concatenate((middle - inset, -middle - inset)),
    )


def _neighbours(places_m: Floats) -> Indices:
    """Return index pairs (e, 2) of Voronoi neighbours, smaller first."""
    count = len(places_m)
    every = np.stack(np.triu_indices(count, 1), axis=1)
    if count <= 4:
        return every
    centre = places_m.mean(axis=0)
    radius = float(np.linalg.norm(places_m - centre, axis=1).max())
    # As for cells, four far points ensure that collinear positions have neighbours.
    far = FAR * np.array([[1.0, 0.1], [-0.1, 1.0], [-1.0, -0.1], [0.1, -1.0]])
    try:
        mesh = Delaunay(np.concatenate(((places_m - centre) / radius, far)))
    except QhullError:
        return every
    if len(mesh.coplanar):
        return every
    corners = np.sort(mesh.simplices, axis=1)
    edges = np.concatenate((corners[:, :2], corners[:, 1:], corners[:, ::2]))
    return np.unique(edges[edges[:, 1] < count], axis=0).astype(np.intp)


def ground_sets(
    ground: Ground,
    places_m: Floats,
    stops_m: Floats,
    aims_m: Floats,  # (n, 2)
    keep_m: float,
    reach_m: float,
) -> SafeSets:
    """Return a convex part of the ground with clearance from borders for each agent."""
    # Shapes: places_m, stops_m (n, 2).
    slack_m = ON_BORDER * ground.hull.radius_m
    outside = ~np.asarray(shapely.dwithin(ground.free, shapely.points(places_m), slack_m))
    if outside.any():
        which = int(outside.argmax())
        x, y = places_m[which]
        raise InputError(f"is at ({x:g}, {y:g}) m, outside the free area", key=f"agents[{which}]")
    if isinstance(ground, ConvexGround):
        region = ground.hull
        heights = np.maximum(places_m @ region.normals.T, stops_m @ region.normals.T)
        agent, side = np.nonzero(heights > region.offsets_m - keep_m - reach_m)
        offsets = np.maximum(region.offsets_m[side] - keep_m, heights[agent, side])
        return half_planes(agent, region.normals[side], offsets)
    border = shapely.boundary(ground.free)
    kept_m = float(shapely.distance(border, ground.area.polygon))  # pyright: ignore[reportUnknownMemberType]
    if kept_m < keep_m - ON_BORDER * ground.hull.radius_m:
        raise InputError(
            f"the region was built with a clearance of {kept_m:g} m, but agents need {keep_m:g} m",
            key="world.clearance_m",
            remedy="build the region with the clearance that agents need",
        )
    # Clip the line to the aim to its reachable and free part.
    line = aims_m - places_m
    length = np.linalg.norm(line, axis=1)
    ends = places_m + line * np.minimum(1.0, reach_m / np.where(length > 0.0, length, 1.0))[:, None]
    for which in np.flatnonzero(~ground.area.sees(places_m, ends)):
        start, end = places_m[which], ends[which].copy()
        crossed = shapely.intersection(ground.area.border, shapely.LineString([start, end]))
        met = np.asarray(shapely.get_coordinates(crossed), dtype=np.float64)
        ends[which] = start
        if len(met):
            free_m = float(np.linalg.norm(met - start, axis=1).min()) - 4.0 * ground.area.slack_m
            ends[which] += (end - start) * max(free_m, 0.0) / float(np.linalg.norm(end - start))
    hulls = shapely.convex_hull(shapely.multipoints(np.stack((places_m, stops_m, ends), axis=1)))
    meets = np.asarray(shapely.intersects(ground.area.border, hulls), dtype=np.bool_)
    # The clearance is round at corners but `allowed` is mitred, so an agent may be outside it.
    meets |= ~ground.allows(places_m)
    ends[meets] = stops_m[meets]
    seeds = np.stack((places_m, stops_m, ends), axis=1)
    touch_m = TOUCHES * ground.hull.radius_m
    # The free area is on the left of the sides.
    sides = polygon_boundaries(np.array([ground.free]), np.zeros((1, 2)))
    edges = np.stack((sides.start_m, sides.end_m), axis=1)
    return _corridors(edges, seeds, keep_m, reach_m, touch_m)


def _corridors(
    edges: Floats, seeds: Floats, keep_m: float, reach_m: float, touch_m: float
) -> SafeSets:
    """Return convex sets around seed triangles (n, 3, 2) that keep clear of edges (m, 2, 2)."""
    # Each nearest boundary point within the half-planes so far defines the next one.
    count = len(seeds)
    agent = np.repeat(np.arange(count), len(edges))
    part = np.tile(edges, (count, 1, 1))
    along = part[:, 1] - part[:, 0]
    outward = np.stack((along[:, 1], -along[:, 0]), axis=1)
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    here, there, gap = _from_triangles(seeds[agent], part)
    close = gap <= reach_m + keep_m
    agent, part, outward = agent[close], part[close], outward[close]
    here, there, gap = here[close], there[close], gap[close]
    found = [UNBOUNDED]
    while len(agent):
        order = np.lexsort((gap, agent))
        first = order[np.append(True, agent[order[1:]] != agent[order[:-1]])]
        chosen, distance = agent[first], gap[first]
        link = there[first] - here[first]
        touching = distance <= touch_m
        normal = link / np.where(touching, 1.0, distance)[:, None]
        shrunk = False
        for row in np.flatnonzero(touching):
            seed = seeds[chosen[row]]
            separating = _touching_normal(outward[first[row]], seed, part[first[row]], touch_m)
            if separating is None:
                seeds[chosen[row]], shrunk = seed[0], True
            else:
                normal[row] = separating
        if shrunk:
            here, there, gap = _from_triangles(seeds[agent], part)
            continue
        base = (normal * there[first]).sum(axis=1)
        within = np.einsum("kjx,kx->kj", seeds[chosen], normal).max(axis=1)
        found.append(half_planes(chosen, normal, np.maximum(base - keep_m, within)))
        # Drop the parts beyond the new half-plane, and the part that defined it.
        row = np.zeros(count, dtype=np.intp)
        row[chosen] = np.arange(len(chosen))
        mine = row[agent]
        depth = base[mine, None] - np.einsum("kjx,kx->kj", part, normal[mine])
        left = (depth > touch_m).any(axis=1)
        left[first] = False
        cut = left & (depth < 0.0).any(axis=1)
        share = depth[cut, 0] / (depth[cut, 0] - depth[cut, 1])
        crossing = part[cut, 0] + share[:, None] * (part[cut, 1] - part[cut, 0])
        beyond = np.flatnonzero(cut)
        part[beyond, (depth[cut, 1] < 0.0).astype(np.intp)] = crossing
        agent, part, outward = agent[left], part[left], outward[left]
        here, there, gap = _from_triangles(seeds[agent], part)
    return joined(*found)


def _touching_normal(outward: Floats, seed: Floats, part: Floats, touch_m: float) -> Floats | None:
    """Return the normal of a line between a triangle and a side that it touches, or None."""
    # None without a separating line; a seed of a single position always has one.
    if ((seed - part[0]) @ outward <= touch_m).all():
        return outward
    along = seed[2] - seed[0]
    across = np.array([along[1], -along[0]]) / max(float(np.linalg.norm(along)), touch_m)
    flat = np.abs((seed - seed[0]) @ across).max() <= touch_m
    for normal in (across, -across):
        if flat and ((part - seed[0]) @ normal >= -touch_m).all():
            return normal
    return None


def _from_triangles(seeds: Floats, parts: Floats) -> tuple[Floats, Floats, Floats]:
    """Return nearest points (n, 2) of each triangle and its segment, and their distances (n,)."""
    here, there = np.zeros((len(seeds), 2)), np.zeros((len(seeds), 2))
    least = np.full(len(seeds), np.inf)
    flat = bool((seeds[:, 0] == seeds[:, 1]).all())
    for side in ((0, 2),) if flat else ((0, 1), (1, 2), (2, 0)):
        one, other = closest_points(seeds[:, side], parts)
        gap = np.linalg.norm(other - one, axis=1)
        better = gap < least
        here[better], there[better], least[better] = one[better], other[better], gap[better]
    return here, there, least


def closest_points(one_m: Floats, other_m: Floats) -> tuple[Floats, Floats]:
    """Return the nearest points of pairs of line segments that do not cross."""
    # Shapes: one_m, other_m (k, 2, 2).
    best = np.full(len(one_m), np.inf)
    here, there = one_m[:, 0].copy(), other_m[:, 0].copy()
    for lines, others, swapped in ((one_m, other_m, False), (other_m, one_m, True)):
        along = others[:, 1] - others[:, 0]
        square = (along * along).sum(axis=1)
        for end in range(2):
            share = ((lines[:, end] - others[:, 0]) * along).sum(axis=1)
            share = np.clip(share / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
            foot = others[:, 0] + share[:, None] * along
            gap = np.linalg.norm(foot - lines[:, end], axis=1)
            better = gap < best
            best[better] = gap[better]
            (there if swapped else here)[better] = lines[better, end]
            (here if swapped else there)[better] = foot[better]
    return here, there
