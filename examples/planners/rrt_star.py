"""RRT* with a communication cost: a metre costs 1 + outage price times P(no connection).

Probabilities come from planopt's channel model. The tree is grown anew at every step, with a fixed
number of samples; the last route is kept while it is cheaper.

``python examples/planners/rrt_star.py simulate open_field --planner rrt_star``
"""

from __future__ import annotations

import sys
from itertools import pairwise
from typing import Any

import numpy as np
from grid import GridPlanner

from planopt import Problem
from planopt.channel.kriging import connection_probability
from planopt.cli import main
from planopt.extend import PlannerKind, register_planner

SAMPLES = 400
GOAL_SHARE = 0.05
"""Share of the samples that are the goal."""
RADIUS_FACTOR = 2.0
"""Rewiring radius over sqrt(area log(n) / n)."""


class RrtStarPlanner(GridPlanner):
    """RRT* on the prices of the grid's cells."""

    def __init__(self, problem: Problem, ground: Any, generator: Any = None) -> None:
        super().__init__(problem, ground)
        self._generator = generator or np.random.default_rng(0)
        self._last: Any = None

    def metre_costs(self, context: Any) -> Any:
        """Return the expected cost per metre at each node (n,)."""
        power = context.predicted(self.nodes_m)
        threshold = self.problem.stations[0].threshold_dbm
        chance = connection_probability(power.mean_db, power.deviation_db, threshold)
        return 1.0 + self.problem.reach.outage_price * (1.0 - chance)

    def route(self, context: Any) -> Any:
        """Return the cheaper of a new route and the rest of the last one."""
        here, costs = context.position_m, self.metre_costs(context)
        routes = [route for route in (self._grown(here, costs), self._rest(here)) if len(route)]
        if not routes:
            return here[None]
        self._last = min(routes, key=lambda route: self._cost(route, costs))
        return self._last

    def _cost(self, route: Any, costs: Any) -> float:
        return sum(self.leg_cost(a, b, costs) for a, b in pairwise(route))

    def _rest(self, here: Any) -> Any:
        """Return the last route from the robot's position on; empty if it has left it."""
        if self._last is None:
            return ()
        route = self._last
        legs = np.diff(route, axis=0)
        share = ((here - route[:-1]) * legs).sum(axis=1) / np.maximum((legs**2).sum(axis=1), 1e-12)
        feet = route[:-1] + np.clip(share, 0.0, 1.0)[:, None] * legs
        away = np.linalg.norm(feet - here, axis=1)
        leg = int(away.argmin())
        return np.vstack([here, route[leg + 1 :]]) if away[leg] < 1e-3 else ()

    def _grown(self, here: Any, costs: Any) -> Any:
        """Return the route of a new tree; empty if it does not reach the goal."""
        low, high = np.reshape(self.problem.workspace.bounds_m, (2, 2))
        area = float(np.prod(high - low))
        reach_m = 4.0 * self.step_m
        places = np.empty((SAMPLES + 1, 2))
        places[0], count = here, 1
        parent, cost = np.zeros(SAMPLES + 1, dtype=int), np.zeros(SAMPLES + 1)
        arrived: list[int] = []
        for _ in range(SAMPLES):
            is_goal = self._generator.uniform() < GOAL_SHARE
            sample = self.goal_m if is_goal else self._generator.uniform(low, high)
            away = np.linalg.norm(places[:count] - sample, axis=1)
            nearest = int(away.argmin())
            if away[nearest] < 1e-6:
                continue
            share = min(1.0, reach_m / away[nearest])
            new = places[nearest] + share * (sample - places[nearest])
            away = np.linalg.norm(places[:count] - new, axis=1)
            radius = min(reach_m, RADIUS_FACTOR * np.sqrt(area * np.log(count + 1) / (count + 1)))
            near = np.unique(np.append(np.flatnonzero(away <= radius), nearest))
            near = near[self.clear(places[near], np.broadcast_to(new, (len(near), 2)))]
            if not len(near):
                continue
            legs = np.array([self.leg_cost(places[one], new, costs) for one in near])
            chosen = int((cost[near] + legs).argmin())
            places[count], parent[count] = new, near[chosen]
            cost[count] = cost[near[chosen]] + legs[chosen]
            for one, leg in zip(near.tolist(), legs.tolist(), strict=True):
                if cost[count] + leg < cost[one] - 1e-9:
                    self._rewire(one, count, cost[count] + leg, parent, cost, count)
            if np.linalg.norm(new - self.goal_m) < 1e-6:
                arrived.append(count)
            count += 1
        if not arrived:
            return ()
        nodes = [min(arrived, key=lambda node: cost[node])]
        while nodes[-1] != 0:
            nodes.append(int(parent[nodes[-1]]))
        return self.shortened(places[nodes[::-1]], costs)

    @staticmethod
    def _rewire(node: int, to: int, new: float, parent: Any, cost: Any, count: int) -> None:
        """Give a node another parent, and its descendants their new costs."""
        gain, parent[node] = cost[node] - new, to
        moved = [node]
        while moved:
            one = moved.pop()
            cost[one] -= gain
            moved += np.flatnonzero((parent[:count] == one) & (np.arange(count) != one)).tolist()


if __name__ == "__main__":
    register_planner(PlannerKind("rrt_star", RrtStarPlanner, reaches_goals=True))
    sys.exit(main())
