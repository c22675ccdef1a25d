"""Low-cost deployments by multi-start search."""

from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.optimize import linear_sum_assignment

from planopt.arrays import Floats, Indices
from planopt.coverage.geodesic import GeodesicGround, Ground

LEAP = 1.7  # Over-relaxation factor of the first trial in every step toward the targets
SETTLED = 1e-6  # Relative decrease of the cost in a step below which a deployment is settled
STARTS = 10  # Number of initial deployments; the first is the problem's own
MAX_STEPS = 500  # Maximum number of steps from one initial deployment
CANDIDATES = 20  # Number of candidate positions per agent for random initial deployments
SINGLES = 3
"""Number of agents, and of destination cells, for the final trials of single relocations."""


@dataclass(frozen=True, eq=False)
class Deployment:
    """Best deployment found for a network."""

    places_m: Floats  # (n, 2) settled positions of the best initial deployment
    cost: float  # Their coverage cost H
    costs: Floats  # (starts,) settled costs of all initial deployments


def best_deployment(
    ground: Ground,
    count: int,
    starts: int,
    generator: np.random.Generator,
    *,
    first_m: Floats | None = None,  # (n, 2) first initial deployment; random if None
) -> Deployment:
    """Find a low-cost deployment by multi-start descent and relocation of single agents."""
    settled: list[tuple[Floats, float]] = []
    for number in range(starts):
        first = first_m if number == 0 else None
        start = draw_start(ground, count, generator) if first is None else first
        settled.append(settle(ground, start))
    costs = np.array([cost for _, cost in settled])
    places, cost = settled[int(costs.argmin())]
    places, cost = _relocated(ground, places, cost)
    return Deployment(places, cost, costs)


def settle(ground: Ground, places_m: Floats) -> tuple[Floats, float]:
    """Move agents to their targets until the cost settles; return positions and cost."""
    places, here = places_m, ground.cover(places_m)
    for _ in range(MAX_STEPS):
        leapt = places + LEAP * (here.targets_m - places)
        fine = ground.allows(leapt)
        leapt[~fine] = here.targets_m[~fine]
        there = ground.cover(leapt)
        if not there.cost < here.cost:
            leapt = here.targets_m
            there = ground.cover(leapt)
        won = here.cost - there.cost
        if won > 0.0:
            places, here = leapt, there
        if won <= SETTLED * here.cost:
            break
    return places, here.cost


def draw_start(ground: Ground, count: int, generator: np.random.Generator) -> Floats:
    """Draw an initial deployment ``(n, 2)`` by weighted sampling, as k-means++ does."""
    # Candidates weigh their mass times the squared distance to the nearest drawn position.
    candidates, mass = _candidates(ground, CANDIDATES * count, generator)
    chosen = [int(generator.choice(len(candidates), p=mass / mass.sum()))]
    nearest = np.full(len(candidates), np.inf)
    while len(chosen) < count:
        away = ((candidates - candidates[chosen[-1]]) ** 2).sum(axis=1)
        nearest = np.minimum(nearest, away)
        weight = mass * nearest
        if not weight.sum() > 0.0:
            weight = np.ones(len(candidates))
        chosen.append(int(generator.choice(len(candidates), p=weight / weight.sum())))
    return candidates[chosen]


def _candidates(
    ground: Ground, count: int, generator: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return allowed candidate positions (m, 2) and their masses (m,)."""
    if isinstance(ground, GeodesicGround):
        return ground.ends_m, ground.mass
    corners = ground.hull.corners_m
    low, high = corners.min(axis=0), corners.max(axis=0)
    found = np.zeros((0, 2))
    while len(found) < count:
        drawn = low + (high - low) * generator.random((2 * count, 2))
        found = np.concatenate((found, drawn[ground.allows(drawn)]))
    mass = ground.density.at(found)
    return found, mass if mass.sum() > 0.0 else np.ones(len(found))


def _relocated(ground: Ground, places: Floats, cost: float) -> tuple[Floats, float]:
    """Relocate the least useful agents to the cells that gain most from a second agent."""
    count = len(places)
    if count < 3:
        return places, cost
    for _ in range(count):
        moves, singles = _relocations(ground, places)
        batches = [moves[: len(moves) >> halving] for halving in range(len(moves).bit_length())]
        for some in (*batches, *([one] for one in singles)):
            moved = places.copy()
            for gone, near, pair in some:
                moved[[gone, near]] = pair
            found = settle(ground, ground.nearest(moved))
            if found[1] < cost * (1.0 - 10.0 * SETTLED):
                places, cost = found
                break
        else:
            break
    return places, cost


Relocation = tuple[int, int, Floats]
"""Agent to move, cell to halve, and new positions (2, 2) of this agent and the cell's agent."""


def _relocations(ground: Ground, places: Floats) -> tuple[list[Relocation], list[Relocation]]:
    """Return relocations to apply together, best first, and others to try one at a time."""
    near = ground.two_nearest(places)
    count, mass = len(places), np.where(near.mass > 0.0, near.mass, 0.0)
    losses = np.bincount(near.owner, mass * (near.second_m2 - near.first_m2), minlength=count)

    def means(group: Indices, groups: int) -> tuple[Floats, Floats]:
        """Return the mass (groups,) and centroid (groups, 2) of each group of sample points."""
        total = np.asarray(np.bincount(group, mass, minlength=groups), dtype=np.float64)
        some = np.where(total > 0.0, total, 1.0)
        sums = [np.bincount(group, mass * axis, minlength=groups) for axis in near.samples_m.T]
        return np.asarray(total, dtype=np.float64), np.stack(sums, axis=1) / some[:, None]

    total, centres = means(near.owner, count)
    x, y = (near.samples_m - centres[near.owner]).T
    spread = [np.bincount(near.owner, mass * u, minlength=count) for u in (x * x, x * y, y * y)]
    angle = 0.5 * np.arctan2(2.0 * spread[1], spread[0] - spread[2])[near.owner]
    upper = x * np.cos(angle) + y * np.sin(angle) > 0.0
    halves, ends = means(2 * near.owner + upper, 2 * count)
    halves, ends = halves.reshape(count, 2), ends.reshape(count, 2, 2)
    apart_m2 = ((ends[:, 0] - ends[:, 1]) ** 2).sum(axis=1)
    gains = halves.prod(axis=1) / np.where(total > 0.0, total, 1.0) * apart_m2
    taken, needy = np.argsort(losses).tolist(), np.argsort(-gains).tolist()
    pairs = ((gone, cell) for gone in taken[:SINGLES] for cell in needy[:SINGLES] if gone != cell)
    singles = [(gone, cell, ends[cell]) for gone, cell in pairs]
    moves, used = list[Relocation](), set[int]()
    left = iter(needy)
    for gone in taken:
        cell = next((each for each in left if each not in used and each != gone), None)
        if cell is None or gone in used or gains[cell] <= losses[gone]:
            break
        used |= {gone, cell}
        moves.append((gone, cell, ends[cell]))
    return moves, singles


class Deployer:
    """Deployment search that assigns positions to the covering agents of a network."""

    def __init__(self, ground: Ground, generator: np.random.Generator) -> None:
        self._ground, self._generator = ground, generator
        self._agents: Indices = np.zeros(0, dtype=np.intp)  # Covering agents, ascending
        self._places = np.zeros((0, 2))  # Their targets

    def places_m(self, agents: Indices, here_m: Floats) -> Floats:
        """Return target positions (k, 2) of the covering agents with ascending indices (k,)."""
        if not np.array_equal(agents, self._agents):
            # After a change, the search starts from the old targets and newcomers' positions.
            first = here_m.copy()
            stays = np.isin(agents, self._agents)
            first[stays] = self._places[np.isin(self._agents, agents)]
            starts = 1 if stays.any() else STARTS
            found = best_deployment(
                self._ground, len(agents), starts, self._generator, first_m=first
            )
            away_m = self._ground.distances_m(here_m, found.places_m)
            _, order = cast("tuple[Indices, Indices]", linear_sum_assignment(away_m**2))
            self._agents, self._places = agents, found.places_m[order]
        return self._places
