"""The lattice as a graph: shortest ways to the goal, and where every move comes from.

The nodes are the lattice's free nodes, numbered in reading order. The graph is built once for a
scene; only node factors change from step to step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra  # pyright: ignore[reportUnknownVariableType]

from planopt.world.lattice import MOVES, Lattice, node_positions


@dataclass(frozen=True)
class RoadMap:
    """Free lattice nodes and the moves between them."""

    lattice: Lattice  # The lattice it was built from
    nodes_m: NDArray[np.float64]  # (n, 2) positions
    rows: NDArray[np.intp]  # (n,) their lattice indices iy, ix
    columns: NDArray[np.intp]
    number: NDArray[np.intp]  # (ny, nx) node number on the lattice, -1 where not free
    # (n, 21) the node from which each of `MOVES` arrives here; n where that move is closed
    sources: NDArray[np.intp]
    lengths_m: NDArray[np.float64]  # (21,) lengths of the moves
    edge_from: NDArray[np.int32]  # The moves but "stay", sorted by `edge_from`, in compressed rows
    edge_to: NDArray[np.int32]
    edge_length_m: NDArray[np.float64]
    edge_start: NDArray[np.int32]


@dataclass(frozen=True)
class CostToGo:
    """Shortest ways from every node to the goal."""

    # (n,) weighted length of the way; infinite where there is none (or beyond the limit)
    cost_m: NDArray[np.float64]
    # (n,) the next node on it; negative at the goal and where there is no way
    next_node: NDArray[np.int32]


def build_road_map(lattice: Lattice) -> RoadMap:
    """Number the free nodes and tabulate the open moves between them."""
    rows, columns = np.nonzero(lattice.free)
    count = len(rows)
    number = np.full(lattice.shape, -1, dtype=np.intp)
    number[rows, columns] = np.arange(count)
    moves = np.asarray(MOVES)
    # A move closed at its start leads to `count`, a node that does not exist and costs infinity.
    targets = np.full((count, len(moves)), count, dtype=np.intp)
    sources = np.full((count, len(moves)), count, dtype=np.intp)
    for k, (dx, dy) in enumerate(moves):
        here = np.nonzero(lattice.open_moves[k, rows, columns])[0]
        there = number[rows[here] + dy, columns[here] + dx]
        targets[here, k] = there
        sources[there, k] = here
    lengths = lattice.spacing_m * np.hypot(moves[:, 0], moves[:, 1])
    is_edge = (targets < count) & (lengths > 0.0)
    edge_from, move = np.nonzero(is_edge)
    edge_start = np.concatenate([[0], np.cumsum(is_edge.sum(axis=1))])
    return RoadMap(
        lattice=lattice,
        nodes_m=node_positions(lattice)[rows, columns],
        rows=rows,
        columns=columns,
        number=number,
        sources=sources,
        lengths_m=lengths,
        edge_from=edge_from.astype(np.int32),
        edge_to=targets[edge_from, move].astype(np.int32),
        edge_length_m=lengths[move],
        edge_start=edge_start.astype(np.int32),
    )


def lattice_paths(
    road_map: RoadMap,
    goal_node: int,
    node_factor: NDArray[np.float64] | None = None,  # (n,) at least 1, or None for plain lengths
    *,
    limit_m: float = math.inf,
) -> CostToGo:
    """Shortest ways to `goal_node`, each metre weighted by the mean factor of its edge's ends."""
    weights = road_map.edge_length_m
    if node_factor is not None:
        # Twice as fast as with both ends looked up: edges are sorted by their first end.
        ends = np.repeat(node_factor, np.diff(road_map.edge_start))
        ends += node_factor.take(road_map.edge_to)
        ends *= weights
        ends *= 0.5
        weights = ends
    return cheapest_paths(road_map, goal_node, weights, limit_m=limit_m)


def cheapest_paths(
    road_map: RoadMap,
    goal_node: int,
    edge_cost_m: NDArray[np.float64],
    *,
    limit_m: float = math.inf,
) -> CostToGo:
    """Cheapest ways to `goal_node`, where each edge has its cost (e,), the same both ways."""
    count = len(road_map.nodes_m)
    graph = csr_matrix((edge_cost_m, road_map.edge_to, road_map.edge_start), shape=(count, count))
    cost, following = cast(
        "tuple[NDArray[np.float64], NDArray[np.int32]]",
        dijkstra(graph, indices=goal_node, return_predecessors=True, limit=limit_m),
    )
    return CostToGo(cost_m=cost, next_node=following)


def route_from(road_map: RoadMap, ways: CostToGo, node: int, length_m: float) -> NDArray[np.intp]:
    """Node numbers along the shortest way from `node` on, until it is `length_m` long."""
    nodes = [node]
    travelled = 0.0
    while travelled < length_m:
        following = int(ways.next_node[nodes[-1]])
        if following < 0:
            break
        travelled += float(
            np.linalg.norm(road_map.nodes_m[following] - road_map.nodes_m[nodes[-1]])
        )
        nodes.append(following)
    return np.asarray(nodes, dtype=np.intp)
