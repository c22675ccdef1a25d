"""A courier without horizon, refinement and proof: the cheapest path on the belief, found again.

Dijkstra's algorithm on the lattice of planopt's own courier, with the same belief, price and
measurements; of the path found the first steps are driven, then it is found anew. What planopt's
courier achieves beyond it is due to planning; what both miss is due to what is known. A courier
that knows the mean power is charged by the chance that fading is deep enough to be out of contact.

``python benchmarks/plain_courier.py --problems A B --first-seed 405 --seeds 5`` prints its
realised cost over that of the clairvoyant, and so for lengths: charged below p_min, charged
everywhere, seeing the true mean power within 40 m of where it has been, and knowing it everywhere.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt import Problem, load
from planopt.channel import measure
from planopt.channel.ground_truth import mean_power_dbm
from planopt.channel.kriging import connection_probability
from planopt.planning.initial_data import Prepared, prepare
from planopt.planning.loop.metrics import clairvoyant_path, realised_cost_m
from planopt.planning.proof.motion import is_at_goal
from planopt.planning.proof.rule import connectivity_law
from planopt.planning.scene import Scene, build_scene, first_moves
from planopt.planning.search.node_margins import NodeMargins
from planopt.planning.stepping import learn_measured
from planopt.world import lattice_paths, route_from

REPLANNED_STEPS = 3
"""A path is driven for so many steps before it is found again."""


def drive_plain(
    problem: Problem, scene: Scene, prepared: Prepared, *, sees_m: float = 0.0
) -> NDArray[np.float64]:
    """Drive to the goal; places (n + 1, 2) at the start and after each step.

    Parameters
    ----------
    problem, scene, prepared
        Problem of one robot, its geometry, and what its seed fixes.
    sees_m
        Within so many metres of where it has been the courier knows the first station's true power
        without small-scale fading, of which it knows the fitted deviation. Where that is infinite,
        what it costs above the clairvoyant is the lattice's and the fading's.
    """
    roads, belief = scene.road_map, prepared.belief
    radio = problem.stations[0]
    everywhere = problem.reach.charges_everywhere
    margins = NodeMargins(roads, radio.threshold_dbm, problem.constraints.p_min, everywhere)
    here = np.asarray(problem.robots[0].start_m, dtype=np.float64)
    power_dbm = mean_power_dbm(prepared.truths[0], roads.nodes_m)
    fading_db = np.full(len(power_dbm), belief.posterior.parameters.multipath_std_db)
    truly_out = 1.0 - connection_probability(power_dbm, fading_db, radio.true_threshold_dbm)
    seen = np.zeros(len(roads.nodes_m), dtype=bool)
    driven, way = [here], here[None]
    for step in range(problem.planner.max_steps):
        if is_at_goal(problem, here):
            break
        if step % REPLANNED_STEPS == 0 or len(way) < 2:
            margins.refresh(connectivity_law(problem, belief.posteriors))
            share = margins.outage_share
            away = np.linalg.norm(roads.nodes_m[:, None] - driven[-REPLANNED_STEPS:], axis=2)
            seen |= (away <= sees_m).any(axis=1) & (sees_m > 0.0)
            share = np.where(seen, truly_out, share)
            factor = 1.0 + problem.reach.outage_price * share
            ways = lattice_paths(roads, scene.goal_node, factor)
            nodes, lengths = first_moves(scene, problem, here)
            first = int(nodes[np.argmin(lengths * factor[nodes] + ways.cost_m[nodes])])
            way = np.vstack([here, roads.nodes_m[route_from(roads, ways, first, np.inf)]])
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


def compare(name: str, seeds: range) -> str:
    """Return lines of a table: means over seeds, by what the courier is charged or sees."""
    problem = load(name)
    scene = build_scene(problem)
    below = replace(problem, objective=replace(problem.reach, outage_charge="below_p_min"))
    kinds = {
        "charged below p_min": (below, 0.0),
        "charged everywhere": (problem, 0.0),
        "sees 40 m": (problem, 40.0),
        "knows the mean power": (problem, np.inf),
    }
    found: dict[str, list[tuple[float, float]]] = {kind: [] for kind in kinds}
    for seed in seeds:
        prepared = prepare(problem, seed)
        known = clairvoyant_path(problem, scene.road_map, scene.index, prepared.truths)
        for kind, (asked, sees_m) in kinds.items():
            driven = drive_plain(asked, scene, prepared, sees_m=sees_m)
            costs = [realised_cost_m(problem, prepared.truths, way) for way in (driven, known)]
            lengths = [
                np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in (driven, known)
            ]
            found[kind].append((costs[0] / costs[1], lengths[0] / lengths[1]))
    lines: list[str] = []
    for kind, ratios in found.items():
        cost, length = np.transpose(ratios)
        lines.append(
            f"| {name} | {kind} | {cost.mean():.3f} | {cost.max():.3f} | {length.mean():.3f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", nargs="+", required=True)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=5)
    asked = parser.parse_args()
    print("| problem | courier | cost ratio, mean | worst | length |\n|---|---|---|---|---|")
    for name in asked.problems:
        print(compare(name, range(asked.first_seed, asked.first_seed + asked.seeds)), flush=True)


if __name__ == "__main__":
    main()
