"""A courier without horizon, refinement and proof: the cheapest path on the belief, found again.

Dijkstra's algorithm on the lattice of planopt's own courier, with the same belief, price and
measurements; of the path found the first steps are driven, then it is found anew. What planopt's
courier achieves beyond it is due to planning; what both miss is due to what is known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.fields.truth import mean_power_dbm, measure
from planopt.planning.arrival import is_at_goal
from planopt.planning.ground import first_moves
from planopt.planning.history import BEGINNING
from planopt.planning.loop.learn import learn_measured
from planopt.planning.prepare import Prepared
from planopt.planning.proof.circumstances import circumstances_of
from planopt.planning.scene import Scene
from planopt.planning.search.node_margins import NodeMargins
from planopt.problems.problem import Problem
from planopt.world.road_map import shortest_ways, way_from

REPLANNED_STEPS = 3
"""A path is driven for so many steps before it is found again."""


def drive_plain(
    problem: Problem, scene: Scene, prepared: Prepared, *, knows_mean: bool = False
) -> NDArray[np.float64]:
    """Drive to the goal; places (n + 1, 2) at the start and after each step.

    Parameters
    ----------
    problem, scene, prepared
        Problem of one robot, its geometry, and what its seed fixes.
    knows_mean
        Whether the courier knows the first station's true power without small-scale fading at every
        node, instead of a belief. What it then costs above the clairvoyant is the lattice's.
    """
    roads, belief = scene.road_map, prepared.belief
    radio = problem.stations[0]
    everywhere = problem.reach.charges_everywhere
    margins = NodeMargins(roads, radio.threshold_dbm, problem.constraints.p_min, everywhere)
    here = np.asarray(problem.robots[0].start_m, dtype=np.float64)
    driven, way = [here], here[None]
    for step in range(problem.planner.max_steps):
        if is_at_goal(problem, here):
            break
        if step % REPLANNED_STEPS == 0 or len(way) < 2:
            broad = circumstances_of(problem, belief.posteriors, BEGINNING).broad
            margins.refresh(belief.posterior, broad)
            share = margins.outage_share
            if knows_mean:
                power = mean_power_dbm(prepared.truths[0], roads.nodes_m)
                share = np.where(power < radio.threshold_dbm, 1.0, 0.0)
            factor = 1.0 + problem.reach.outage_price * share
            ways = shortest_ways(roads, scene.goal_node, factor)
            nodes, lengths = first_moves(scene.ground, problem, here)
            first = int(nodes[np.argmin(lengths * factor[nodes] + ways.cost_m[nodes])])
            way = np.vstack([here, roads.nodes_m[way_from(roads, ways, first, np.inf)]])
        way = _after(way, problem.step_length_m)
        here = way[0]
        driven.append(here)
        measured = [measure(truth, here[None]) for truth in prepared.truths]
        belief = learn_measured(problem, belief, measured)
    return np.array(driven)


def _after(way_m: NDArray[np.float64], length_m: float) -> NDArray[np.float64]:
    """What is left of a path (n, 2) after `length_m` of it; its last place at least."""
    along = np.append(0.0, np.linalg.norm(np.diff(way_m, axis=0), axis=1).cumsum())
    if length_m >= along[-1]:
        return way_m[-1:]
    at = [np.interp(length_m, along, way_m[:, axis]) for axis in (0, 1)]
    return np.vstack([at, way_m[along > length_m]])
