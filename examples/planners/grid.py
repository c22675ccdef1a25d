"""A grid of the free space with A*, and a planner that follows the cheapest route at full speed."""

from __future__ import annotations

import heapq
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np

from planopt import Plan, Problem
from planopt.extend import released
from planopt.world import clearance_m, segments_clear

PAD_M, STEP_SHARE, SPACING_SHARE = 2e-3, 1.0 - 1e-6, 0.3
"""Reserves of clearance and step for the verifier's tolerances; grid spacing in steps."""

NEIGHBOURS = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)])


class GridPlanner:
    """Plans a route on a grid and follows it at full speed."""

    def __init__(self, problem: Problem, ground: Any, _generator: Any = None) -> None:
        self.problem, self.index = problem, ground.index
        self.required_m = problem.constraints.clearance_m + PAD_M
        self.step_m = problem.step_length_m * STEP_SHARE
        self.goal_m = np.array(problem.goal_m)
        x_min, y_min, x_max, y_max = problem.workspace.bounds_m
        self.spacing_m = SPACING_SHARE * problem.step_length_m
        x = np.arange(x_min, x_max + 1e-9, self.spacing_m)
        y = np.arange(y_min, y_max + 1e-9, self.spacing_m)
        self.corner_m, self.shape = np.array([x_min, y_min]), (len(x), len(y))
        self.nodes_m = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        free = clearance_m(self.index, self.nodes_m) >= self.required_m
        cells = np.stack(np.unravel_index(np.arange(len(self.nodes_m)), self.shape), axis=1)
        self.edges: list[list[tuple[int, float]]] = [[] for _ in self.nodes_m]
        for move in NEIGHBOURS:
            ends = cells + move
            inside = ((ends >= 0) & (ends < self.shape)).all(axis=1)
            first = np.flatnonzero(inside & free)
            last = np.ravel_multi_index(tuple(ends[first].T), self.shape)
            first, last = first[free[last]], last[free[last]]
            clear = self.clear(self.nodes_m[first], self.nodes_m[last])
            length = float(np.linalg.norm(move)) * self.spacing_m
            for a, b in zip(first[clear].tolist(), last[clear].tolist(), strict=True):
                self.edges[a].append((b, length))

    def clear(self, starts_m: Any, ends_m: Any) -> Any:
        """Return whether segments (n, 2) keep the clearance."""
        return segments_clear(self.index, starts_m, ends_m, self.required_m)

    def metre_costs(self, context: Any) -> Any:
        """Return the cost per metre at each node (n,), at least 1; infinite where forbidden."""
        raise NotImplementedError

    def route(self, context: Any) -> Any:
        """Return a route (k, 2) from the robot to the goal; only the robot if there is none."""
        here, costs = context.position_m, self.metre_costs(context)
        corners = self.searched(here, costs)
        return self.shortened(np.array(corners), costs) if corners else here[None]

    def searched(self, here: Any, costs: Any) -> list[Any]:
        """Return the cheapest path on the grid by A*; empty if there is none."""
        (starts, first_m), (ends, last_m) = self.joined(here), self.joined(self.goal_m)
        to_goal = dict(zip(ends.tolist(), last_m.tolist(), strict=True))
        ahead = np.linalg.norm(self.nodes_m - self.goal_m, axis=1)
        known = dict(zip(starts.tolist(), first_m.tolist(), strict=True))
        before: dict[int, int] = {}
        heap = [(length + ahead[node], node) for node, length in known.items()]
        heapq.heapify(heap)
        best, done = (np.inf, -1), set[int]()
        while heap:
            bound, node = heapq.heappop(heap)
            if bound >= best[0]:
                break
            if node in done:
                continue
            done.add(node)
            if node in to_goal:
                best = min(best, (known[node] + to_goal[node], node))
            for other, length in self.edges[node]:
                cost = known[node] + 0.5 * length * (costs[node] + costs[other])
                if cost < known.get(other, np.inf):
                    known[other], before[other] = cost, node
                    heapq.heappush(heap, (cost + ahead[other], other))
        if best[1] < 0:
            return []
        nodes = [best[1]]
        while nodes[-1] in before:
            nodes.append(before[nodes[-1]])
        return [here, *self.nodes_m[nodes[::-1]], self.goal_m]

    def joined(self, place_m: Any) -> tuple[Any, Any]:
        """Return the nodes near a position that a free segment joins to it, and the lengths."""
        away = np.linalg.norm(self.nodes_m - place_m, axis=1)
        near = np.flatnonzero(away <= 1.5 * self.spacing_m)
        near = near[[bool(self.edges[node]) for node in near]]
        clear = self.clear(np.broadcast_to(place_m, (len(near), 2)), self.nodes_m[near])
        return near[clear], away[near[clear]]

    def shortened(self, corners: Any, costs: Any) -> Any:
        """Return a route with straight shortcuts that cost no more."""
        legs = np.array([self.leg_cost(a, b, costs) for a, b in pairwise(corners)])
        kept = [0]
        while kept[-1] < len(corners) - 1:
            here, chosen = kept[-1], kept[-1] + 1
            ahead = np.arange(here + 2, min(here + 60, len(corners)))
            clear = self.clear(np.broadcast_to(corners[here], (len(ahead), 2)), corners[ahead])
            for other in ahead[clear][::-1]:
                straight = self.leg_cost(corners[here], corners[other], costs)
                if straight <= legs[here:other].sum() + 1e-9:
                    chosen = int(other)
                    break
            kept.append(chosen)
        return corners[kept]

    def leg_cost(self, start: Any, end: Any, costs: Any) -> float:
        """Return the cost of a straight leg, by sampling its cells."""
        length = float(np.linalg.norm(end - start))
        count = max(int(np.ceil(2.0 * length / self.spacing_m)), 1)
        places = start + (np.arange(count)[:, None] + 0.5) / count * (end - start)
        cells = np.rint((places - self.corner_m) / self.spacing_m).astype(int)
        cells = np.clip(cells, 0, np.array(self.shape) - 1)
        return length * float(costs[np.ravel_multi_index(tuple(cells.T), self.shape)].mean())

    def path(self, context: Any) -> Any:
        """Return the positions (N, 2) after each step along the route, at full speed."""
        route = self.route(context)
        along = np.append(0.0, np.linalg.norm(np.diff(route, axis=0), axis=1).cumsum())
        places, at = [route[0]], 0.0
        for _ in range(self.problem.planner.horizon):
            corner = along[min(np.searchsorted(along, at + 1e-9), len(along) - 1)]
            for stop in (*(at + share * self.step_m for share in (1.0, 0.75, 0.5, 0.25)), corner):
                stop = min(stop, along[-1], at + self.step_m)
                end = np.array([np.interp(stop, along, route[:, axis]) for axis in (0, 1)])
                if self.clear(places[-1][None], end[None])[0]:
                    at = stop
                    break
            else:
                end = places[-1]
            places.append(end)
        return np.array(places[1:])

    def plan(self, context: Any, scorer: Any, warm: Plan | None = None) -> Plan:
        """Return the plan, which planopt verifies."""
        begun = perf_counter()
        return released(scorer, self.path(context), begun)
