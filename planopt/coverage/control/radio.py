"""Trees of radio links that moving agents maintain.

The failure probabilities of the links along a path are added (union bound). Both ends of a link
stay in a disc whose diameter is the largest length that the link's share of the sum allows.
"""

import itertools
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree
from scipy.special import ndtr

from planopt.arrays import Floats, Indices, Mask
from planopt.coverage.control.safe_sets import SPARE, UNBOUNDED, SafeSets, half_planes, joined
from planopt.coverage.limits import LinkLaw, RadioLimits, StationMap, line_distances_m

LENGTHS_M = np.geomspace(1e-2, 1e5, 40_001)
"""Tabulated link lengths; the length of a link is rounded up to the next entry."""
HOP = 0.02
"""Minimum link weight as a share of the allowed failure probability; it limits the tree depth."""


@dataclass(frozen=True, eq=False)
class RadioTree:
    """Tree of radio links, and safe sets in which agents maintain these links."""

    # (n,) parent of each agent; -1 - k for station k. A disconnected agent is its own parent.
    parent: Indices
    failure: Floats  # (n,) upper bound of the probability that the path to a station fails
    kept: SafeSets  # Sets in which agents keep all links; no constraint for disconnected agents

    @property
    def connected(self) -> Mask:
        """Return a mask (n,) of the agents that the tree connects to a station."""
        return self.parent != np.arange(len(self.parent))


def radio_tree(places_m: Floats, radio: RadioLimits, stops_m: Floats | None = None) -> RadioTree:
    """Return the tree of most reliable paths from agents (n, 2) to base stations."""
    stops = places_m if stops_m is None else stops_m
    count, allowed = len(places_m), 1.0 - radio.p_min
    between, mapped = _failures(radio.agent_link, radio), radio.station_link
    pairs, centres, lengths = _links(places_m, stops, _longest(between, allowed))
    if isinstance(mapped, StationMap):
        direct, alone = np.zeros(0), mapped.near(places_m, stops)
    else:
        ends = np.stack((places_m, stops), axis=1)[:, :, None] - radio.stations_m
        direct = _failures(mapped, radio)
        alone = _at(direct, np.linalg.norm(ends, axis=3).max(axis=1))
    station = alone.argmin(axis=1)
    # Links to stations come last; all stations are represented by node n.
    agents = np.arange(count)
    pairs = np.concatenate((pairs, np.stack((agents, np.full(count, count)), axis=1)))
    fails = np.concatenate((_at(between, lengths), alone[agents, station]))
    for least in (HOP * allowed, np.finfo(np.float64).tiny):
        link, failure, order = _tree(pairs, np.maximum(fails, least), fails, count)
        if (failure <= allowed).all():
            break
    linked = [agent for agent in order if failure[agent] <= allowed]
    up = {agent: int(pairs[link[agent]].sum()) - agent for agent in linked}
    depth = dict.fromkeys([count], 0)
    for agent in linked:
        depth[agent] = depth[up[agent]] + 1
    # Largest failure sum and largest number of links of any path through the agent.
    most, deepest = failure.copy(), dict(depth)
    for agent in reversed(linked):
        if up[agent] != count:
            most[up[agent]] = max(most[up[agent]], most[agent])
            deepest[up[agent]] = max(deepest[up[agent]], deepest[agent])
    parent = agents.copy()
    discs: list[tuple[int, Floats, float]] = []
    planes = [UNBOUNDED]
    for agent in linked:
        may_fail = fails[link[agent]] + (allowed - most[agent]) / deepest[agent]
        if up[agent] == count:
            parent[agent] = -1 - station[agent]
            if isinstance(mapped, StationMap):
                bad = mapped.nodes_m[mapped.failures[station[agent]] > may_fail]
                planes.append(_clear_of(bad, mapped.radius_m, agent, places_m[agent], stops[agent]))
                continue
            middle = radio.stations_m[station[agent]]
            discs.append((agent, middle, _longest(direct, may_fail)))
        else:
            parent[agent] = up[agent]
            half = 0.5 * _longest(between, may_fail)
            discs += [(end, centres[link[agent]], half) for end in (agent, up[agent])]
    balls = replace(
        UNBOUNDED,
        disc_agent=np.array([one[0] for one in discs], dtype=np.intp),
        centres_m=np.array([one[1] for one in discs]).reshape(-1, 2),
        radii_m=np.array([one[2] for one in discs]),
    )
    kept = joined(balls, *planes)
    return RadioTree(parent, np.where(failure <= allowed, failure, 1.0)[:count], kept)


def _clear_of(nodes: Floats, radius_m: float, agent: int, place: Floats, stop: Floats) -> SafeSets:
    """Return half-planes that contain an agent's braking path and exclude discs about `nodes`."""
    # The nearest disc defines a half-plane, the nearest disc inside it the next one, and so on.
    radius = (1.0 + SPARE) * radius_m
    normals, offsets = list[Floats](), list[float]()
    foot, away = line_distances_m(nodes, place, stop)
    while len(nodes):
        first = int(away.argmin())
        normal = (nodes[first] - foot[first]) / away[first]
        base = float(normal @ nodes[first])
        normals.append(normal)
        offsets.append(max(base - radius, float(normal @ place), float(normal @ stop)))
        left = nodes @ normal < base
        left[first] = False
        nodes, foot, away = nodes[left], foot[left], away[left]
    return half_planes(
        np.full(len(offsets), agent), np.array(normals).reshape(-1, 2), np.array(offsets)
    )


def _failures(law: LinkLaw, radio: RadioLimits) -> Floats:
    """Return the largest failure probability of links up to each length in `LENGTHS_M`."""
    decades = -10.0 * np.log10(LENGTHS_M)
    mean = law.theta[0] + law.theta[1] * decades
    path_loss = law.theta_covariance
    variance = path_loss[0, 0] + decades * (2.0 * path_loss[0, 1] + decades * path_loss[1, 1])
    deviation = np.sqrt(np.maximum(variance, 0.0) + law.deviation_db**2)
    margin = mean - radio.threshold_dbm
    # With zero standard deviation a link holds or fails with certainty.
    score = margin / np.maximum(deviation, 1e-9)
    return np.maximum.accumulate(np.asarray(ndtr(-score), dtype=np.float64))


def _at(failures: Floats, lengths_m: Floats) -> Floats:
    """Look up the failure probabilities of links at rounded-up lengths; 1 beyond the table."""
    return np.append(failures, 1.0)[np.searchsorted(LENGTHS_M, lengths_m)]


def _longest(failures: Floats, may_fail: float) -> float:
    """Return the largest link length with failure probability at most `may_fail`; 0 if none."""
    number = int(np.searchsorted(failures, may_fail, side="right"))
    return float(LENGTHS_M[number - 1]) if number else 0.0


def _links(places: Floats, stops: Floats, longest_m: float) -> tuple[Indices, Floats, Floats]:
    """Return pairs (e, 2) of agents in range, each with a circle around both braking paths."""
    # Circles have centres (e, 2) and diameters (e,); the diameter counts as the link length.
    middle, half = 0.5 * (places + stops), 0.5 * np.linalg.norm(stops - places, axis=1)
    tree = KDTree(middle)
    pairs = tree.query_pairs(longest_m + 2.0 * float(half.max()), output_type="ndarray")
    one, other = pairs[:, 0], pairs[:, 1]
    if not half.any():
        centres = 0.5 * (places[one] + places[other])
        return pairs, centres, np.linalg.norm(places[one] - places[other], axis=1)
    corners = np.stack((places[one], stops[one], places[other], stops[other]), axis=1)
    best, least = corners[:, 0].copy(), np.full(len(pairs), np.inf)
    for chosen in itertools.chain(*(itertools.combinations(range(4), size) for size in (2, 3))):
        a, b, c = corners[:, chosen[0]], corners[:, chosen[1]], corners[:, chosen[-1]]
        centre = 0.5 * (a + b)
        if len(chosen) == 3:
            u, v = b - a, c - a
            twice = 2.0 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
            flat = np.abs(twice) < 1e-12 * ((u * u).sum(axis=1) + (v * v).sum(axis=1))
            scaled = (u * u).sum(axis=1)[:, None] * v - (v * v).sum(axis=1)[:, None] * u
            offset = np.stack((scaled[:, 1], -scaled[:, 0]), axis=1)
            centre = a + offset / np.where(flat, 1.0, twice)[:, None]
        # Any centre is valid with a sufficient radius; the smallest circle is chosen.
        radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
        better = radius < least
        best[better], least[better] = centre[better], radius[better]
    return pairs, best, 2.0 * least


def _tree(
    pairs: Indices, weights: Floats, fails: Floats, count: int
) -> tuple[Indices, Floats, list[int]]:
    """Return the tree of shortest paths to the base station over weighted links (e, 2)."""
    # Links (n,), sums of `fails` (n + 1,) along the paths, and agents by distance.
    shape = (count + 1, count + 1)
    graph = csr_array((weights, (pairs[:, 0], pairs[:, 1])), shape=shape)
    number = csr_array((np.arange(1, len(pairs) + 1), (pairs[:, 0], pairs[:, 1])), shape=shape)
    far, before = cast(
        "tuple[Floats, NDArray[np.int32]]",
        cast("Any", dijkstra)(graph, directed=False, indices=count, return_predecessors=True),
    )
    order = [int(agent) for agent in np.argsort(far, kind="stable")[1:] if np.isfinite(far[agent])]
    failure, link = np.full(count + 1, np.inf), np.zeros(count, dtype=np.intp)
    failure[count] = 0.0
    for agent in order:
        up = int(before[agent])
        link[agent] = cast("int", number[min(agent, up), max(agent, up)]) - 1
        failure[agent] = failure[up] + fails[link[agent]]
    return link, failure[: count + 1], order
