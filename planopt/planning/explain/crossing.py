"""Why a plan's way to a goal crosses coverage holes, and what keeping contact would take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.planning.ground import first_moves
from planopt.planning.holes import SHORTEST_IN_WORDS_M, Hole
from planopt.planning.plan import Plan
from planopt.planning.proof.broad_prediction import broad_prediction
from planopt.planning.scene import Scene, build_scene
from planopt.planning.search.node_margins import NodeMargins
from planopt.problems.problem import Problem
from planopt.world.road_map import shortest_ways, way_from

BY_ALL_MEANS = 1e4
"""Price at which contact counts first and length second."""


@dataclass(frozen=True)
class Crossing:
    """The coverage holes that a way to a goal crosses, and the way with the best contact beside it.

    Attributes
    ----------
    robot
        Whose way it is.
    holes
        In the order of the way.
    cost_m
        What the cheapest way over the lattice costs, in metres at `outage_price`.
    outage_price
        ``objective.outage_price``.
    kept_m
        Length of the way that is out of contact for the fewest metres.
    outside_m
        How many those are: zero where a way keeps the bound all along.
    p_min
        The bound.
    """

    robot: str
    holes: tuple[Hole, ...]
    cost_m: float
    outage_price: float
    kept_m: float
    outside_m: float
    p_min: float

    @property
    def at_goal(self) -> bool:
        """Whether the goal itself is below the bound."""
        return bool(self.holes) and self.holes[-1].to_end

    def __str__(self) -> str:
        """Where the holes are, how long, and why they are crossed."""
        where = "; ".join(hole.words for hole in self.holes)
        goal = "; the goal is itself below it" if self.at_goal else ""
        instead = (
            f"the way that keeps it all along is {self.kept_m:.0f} m long"
            if self.outside_m < SHORTEST_IN_WORDS_M and not self.at_goal
            else f"no way keeps it: the best is out of contact for {self.outside_m:.1f} of its "
            f"{self.kept_m:.0f} m"
        )
        return (
            f"crosses {where}: below constraints.p_min {self.p_min:g}{goal}; the way costs "
            f"{self.cost_m:.0f} m at objective.outage_price {self.outage_price:g}, and {instead}"
        )


def explain_crossing(
    problem: Problem, posteriors: Sequence[ChannelPosterior], plan: Plan
) -> Crossing | None:
    """Return what a robot's way to its goal crosses and why; None where it keeps the bound.

    Parameters
    ----------
    problem
        With this robot alone.
    posteriors
        What is believed of each station.
    plan
        The robot's plan from its start.
    """
    if not plan.holes:
        return None
    scene = build_scene(problem)
    rule, constraints = problem.constraints.rule, problem.constraints
    threshold_dbm = problem.stations[0].threshold_dbm - (rule.slack_max_db or 0.0)
    margins = NodeMargins(scene.road_map, threshold_dbm, constraints.p_min)
    margins.refresh(posteriors[0], broad_prediction(problem, posteriors))
    price, start = problem.reach.outage_price, plan.positions_m[0]
    cost_m, _ = _way(problem, scene, margins, start, price * margins.outage_share)
    _, way = _way(problem, scene, margins, start, np.where(margins.outside, BY_ALL_MEANS, 0.0))
    lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
    outside = margins.at(way)[0] < 0.0
    return Crossing(
        plan.robot,
        plan.holes,
        cost_m,
        price,
        float(lengths.sum()),
        float(0.5 * lengths @ (outside[:-1].astype(float) + outside[1:])),
        constraints.p_min,
    )


def _way(
    problem: Problem,
    scene: Scene,
    margins: NodeMargins,
    start_m: NDArray[np.float64],
    surcharge: NDArray[np.float64],
) -> tuple[float, NDArray[np.float64]]:
    """Cost and places (n, 2) of the cheapest way from a place to the goal.

    A metre at each node costs one and its `surcharge` (n,).
    """
    road_map = scene.road_map
    ways = shortest_ways(road_map, scene.goal_node, 1.0 + surcharge)
    nodes, lengths = first_moves(scene.ground, problem, start_m)
    first = int(np.argmin(lengths * (1.0 + surcharge[nodes]) + ways.cost_m[nodes]))
    cost_m = float(lengths[first] * (1.0 + surcharge[nodes[first]]) + ways.cost_m[nodes[first]])
    rest = way_from(road_map, ways, int(nodes[first]), np.inf)
    return cost_m, np.vstack([start_m, road_map.nodes_m[rest]])
