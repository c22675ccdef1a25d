"""Context of one planning step: belief, state, target, steering, region, other robots' plans.

The others' future measurements are treated as made, with the predicted power as value: variances do
not depend on measured values. The information of a path given the others' paths is

    F(path | others) = F(path and others) - F(others),

so that the conditional values of all robots add up to the value of the team.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.kriging import Prediction, connection_probability
from planopt.channel.measurements import SAME_PLACE_M
from planopt.channel.neighbours import PlaceTree
from planopt.channel.posterior import ChannelPosterior, with_expected
from planopt.objectives.measuring import MeasuringRule
from planopt.objectives.moments import Region
from planopt.objectives.terms.term import Aim, Pending, SteeringPath, Structure, explores
from planopt.planning.proof.rule import (
    VerifierContext,
    cached_property,
    search_power,
    search_prediction,
)
from planopt.planning.tolerances import (
    CLEARANCE_PAD_M,
    CLEARANCE_TOLERANCE_M,
    STANDSTILL_M,
    STEP_PAD_M,
)
from planopt.problems.problem import Problem
from planopt.targets.information_filter import TargetModel
from planopt.world.clearance import (
    ObstacleIndex,
    clearance_m,
    index_obstacles,
    inside_bounds,
    segments_clear,
)
from planopt.world.lattice import MOVES, Lattice, moves_from


def steering_path(
    problem: Problem, index: ObstacleIndex, turns_m: Floats, lattice_m: Floats | None = None
) -> SteeringPath:
    """Return a steering path with turns `turns_m` (m, 2)."""
    in_order = any(term.steers == "goal" for term in problem.terms)
    apart_m = problem.constraints.clearance_m - CLEARANCE_TOLERANCE_M
    return SteeringPath(turns_m, index, apart_m, lattice_m, in_order)


PLACES = 200  # Approximate number of grid cells that represent the workspace
NEAR_PLACES = 900  # Approximate number of grid cells where a plan can change the channel map
ROOM_STEPS = 5.0  # Margin around the reachable positions in longest steps


def workspace_region(problem: Problem) -> Region:
    """Return the workspace as a region: grid positions outside obstacles with equal weights."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    grid = _centres((x_min, y_min, x_max, y_max), _coarse_m(problem))
    free = grid[clearance_m(index_obstacles(problem.workspace), grid) > 0.0]
    places = free if len(free) else grid
    return Region(places, np.full(len(places), 1.0 / len(places)))


def region_near(problem: Problem, whole: Region, position_m: Floats) -> Region:
    """Return the region `whole` with a fine grid near a robot's position (2,)."""
    # The coarse grid alone would strongly overestimate the value of plans through its nodes.
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    reach = problem.step_length_m * (problem.planner.horizon + ROOM_STEPS)
    low = np.maximum(position_m - reach, (x_min, y_min))
    high = np.minimum(position_m + reach, (x_max, y_max))
    side = high - low
    cell, coarse = math.sqrt(float(side.prod()) / NEAR_PLACES), _coarse_m(problem)
    if not (side > 0.0).all() or cell >= coarse:
        return whole
    near = _centres((low[0], low[1], high[0], high[1]), cell)
    near = near[clearance_m(index_obstacles(problem.workspace), near) > 0.0]
    far = whole.grid_m[~((whole.grid_m >= low) & (whole.grid_m <= high)).all(axis=1)]
    weight = np.concatenate([np.full(len(near), cell**2), np.full(len(far), coarse**2)])
    if not len(weight):
        return whole
    return Region(np.concatenate([near, far]), weight / weight.sum())


def region_along(problem: Problem, region: Region, path_m: Floats) -> Region:
    """Return the part of the map `region` that measurements near `path_m` (N, 2) can change."""
    away = np.linalg.norm(region.grid_m[:, None] - path_m, axis=2).min(axis=1)
    near = away <= ROOM_STEPS * problem.step_length_m
    return Region(region.grid_m[near], region.weight[near]) if near.any() else region


def _coarse_m(problem: Problem) -> float:
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    return math.sqrt((x_max - x_min) * (y_max - y_min) / PLACES)


def _centres(bounds_m: tuple[float, float, float, float], cell_m: float) -> Floats:
    """Return the centres (n, 2) of cells about `cell_m` wide that fill the bounds, row by row."""
    x_min, y_min, x_max, y_max = bounds_m
    x, y = (
        low + (high - low) * (np.arange(count) + 0.5) / count
        for low, high in ((x_min, x_max), (y_min, y_max))
        for count in (max(1, round((high - low) / cell_m)),)
    )
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


FINER = 4
"""Subdivision of the lattice spacing, for intermediate positions once all nodes are measured."""


def learns(problem: Problem) -> bool:
    """Return whether any term of the problem guides its robots to unmeasured positions."""
    return any(explores(term) for term in problem.terms)


def left_to_learn(
    problem: Problem,
    index: ObstacleIndex,
    lattice: Lattice,
    here_m: Floats,  # (2,) position of the robot
    posteriors: Sequence[ChannelPosterior],
) -> Floats:
    """Return the reachable positions (k, 2) at which measurements are informative."""
    # They are lattice nodes, or intermediate positions if all nodes are measured. If all terms have
    # a variance threshold, they are the positions of the workspace grid above the threshold.
    nodes = lattice.positions_m[reachable_nodes(problem, index, lattice, here_m)]
    rule = MeasuringRule.of(posteriors, problem.channel.measure_spacing_m)
    limits = [term.variance_threshold for term in problem.terms if explores(term)]
    known = [limit for limit in limits if limit is not None]
    if known and len(known) == len(limits):
        places = _joined(problem, index, nodes, workspace_region(problem).grid_m)
        places = places[rule.is_open(places)]
        if not len(places):
            return places
        variance = np.max(
            [search_power(station, places).deviation_db ** 2 for station in posteriors], axis=0
        )
        return places[variance > min(known)]
    left = nodes[rule.is_open(nodes)]
    if len(left) or not len(nodes):
        return left
    share = lattice.spacing_m * (np.arange(FINER) / FINER - 0.5)
    around = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 1, 2)
    between = (nodes + around).reshape(-1, 2)
    between = between[rule.is_open(between)]
    return _joined(problem, index, nodes, between)


def reachable_nodes(
    problem: Problem, index: ObstacleIndex, lattice: Lattice, here_m: Floats
) -> Mask:
    """Return a mask (ny, nx) of nodes reachable by lattice moves from a position (2,)."""
    found = np.zeros(lattice.shape, dtype=np.bool_)
    reach = problem.step_length_m - STEP_PAD_M
    rows, columns, clear = moves_from(
        index, lattice, here_m, reach, problem.constraints.clearance_m
    )
    if not clear.any():
        return found
    number = np.arange(found.size).reshape(lattice.shape)
    begins: list[Indices] = []
    ends: list[Indices] = []
    for (dx, dy), opened in zip(MOVES, lattice.open_moves, strict=True):
        begin = number[opened]
        begins.append(begin)
        ends.append(begin + dy * lattice.shape[1] + dx)
    begin, end = np.concatenate(begins), np.concatenate(ends)
    graph = csr_matrix((np.ones(len(begin)), (begin, end)), shape=(found.size, found.size))
    _, part = cast("tuple[int, NDArray[np.int32]]", connected_components(graph, directed=False))
    part = part.reshape(lattice.shape)
    return np.isin(part, part[rows[clear], columns[clear]]) & lattice.free


def _joined(problem: Problem, index: ObstacleIndex, nodes_m: Floats, places_m: Floats) -> Floats:
    """Return the positions that have a collision-free segment from their nearest node."""
    places = places_m[inside_bounds(problem.workspace, places_m)]
    if not len(places) or not len(nodes_m):
        return places[:0]
    nearest = nodes_m[PlaceTree(nodes_m).nearest(places, 1)[0][:, 0]]
    wanted = problem.constraints.clearance_m + CLEARANCE_PAD_M
    return places[segments_clear(index, nearest, places, wanted)]


MOST_DRIVEN = 256
"""Maximum number of positions visited by other robots that are considered, nearest first."""


def anticipated(
    posteriors: Sequence[ChannelPosterior], pending: Pending, position_m: Floats, spacing_m: float
) -> tuple[ChannelPosterior, ...]:
    """Return each station's posterior after the other robots' past and planned measurements."""
    # Shapes: position_m (2,), position of the robot.
    away = np.linalg.norm(pending.driven_m - position_m, axis=1)
    near = np.sort(np.argsort(away, kind="stable")[:MOST_DRIVEN])
    places = np.vstack([pending.driven_m[near], *pending.planned_m])
    if len(places):
        taken = MeasuringRule.of(posteriors, spacing_m).takes(places[None])[0]
        places = places[taken]
    if not len(places):
        return tuple(posteriors)
    return tuple(with_expected(posterior, places) for posterior in posteriors)


def places_of_others(driven_m: Sequence[Floats], number: int) -> Floats:
    """Return the past positions (k, 2) of all robots except robot `number`."""
    others = [places for other, places in enumerate(driven_m) if other != number]
    return np.vstack([np.zeros((0, 2)), *others])


def counts_others(problem: Problem) -> bool:
    """Return whether any term depends on the measurements of other robots of the team."""
    return problem.planner.coordination == "joint" and any(
        explores(term) or term.probes_end for term in problem.terms
    )


def shares_places(problem: Problem) -> bool:
    """Return whether measurements or probes change the value of positions nearby."""
    return any(term.is_measured or term.steers == "connection" for term in problem.terms)


def structure_of(problem: Problem) -> Structure:
    """Return the sparsity of the objective's Hessian: ``stagewise``, ``chain`` or ``full``."""
    found = {term.structure for term in problem.terms}
    if "full" in found:
        return "full"
    return "chain" if "chain" in found else "stagewise"


def bends_guesses(problem: Problem, *, steered: bool = True) -> bool:
    """Return whether the search adds a fan of paths in all directions to the lattice paths."""
    # A fan is for coupled terms that propose no paths (probes, `steered`) themselves.
    return any(
        term.structure == "full" and not term.probes_end and not (steered and term.steers)
        for term in problem.terms
    )


def target_model(problem: Problem) -> TargetModel:
    """Return the target's constant-velocity model with isotropic white acceleration noise."""
    deviation = problem.targets[0].acceleration_std_m_s2
    return TargetModel(problem.planner.step_s, deviation**2 * np.eye(2))


Made = TypeVar("Made")


@dataclass(frozen=True, eq=False, kw_only=True)
class StepContext(VerifierContext):
    """Inputs on which the objective value of a path depends in one planning step."""

    region: Region  # Region of the map, for terms that average over it
    aim: Aim  # External inputs of the objective
    # Steering path; None if no term steers or no steering position is reachable
    steering: SteeringPath | None = None
    _power: dict[bytes, tuple[float, float]] = field(
        default_factory=dict[bytes, tuple[float, float]], init=False, repr=False
    )
    _soon: dict[bytes, Floats] = field(default_factory=dict[bytes, Floats], init=False, repr=False)
    _made: dict[Hashable, Any] = field(default_factory=dict[Hashable, Any], init=False, repr=False)

    def once(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """Return the result of `make`, cached by key."""
        if key not in self._made:
            self._made[key] = make()
        return cast("Made", self._made[key])

    @property
    def step_s(self) -> float:
        """Duration of a step."""
        return self.problem.planner.step_s

    @property
    def step_length_m(self) -> float:
        """Maximum length of a step."""
        return self.problem.step_length_m

    @property
    def standstill_m(self) -> float:
        """Maximum length of a step that counts as waiting."""
        return STANDSTILL_M

    @property
    def target_motion(self) -> TargetModel:
        """Return the motion model of the target."""
        return target_model(self.problem)

    def power(self, places_m: Floats) -> Prediction:
        """Return the power predicted for searches at `places_m` (n, 2), cached by position."""
        # With many measurements predictions depend slightly on those made together.
        keys = [place.tobytes() for place in np.asarray(places_m, dtype=np.float64)]
        new = {
            key: place for key, place in zip(keys, places_m, strict=True) if key not in self._power
        }
        if new:
            new |= self._soon
            self._soon.clear()
            found = search_prediction(self.law, np.array(list(new.values())))
            values = zip(found.mean_db.tolist(), found.deviation_db.tolist(), strict=True)
            self._power.update(zip(new, values, strict=True))
        both = np.array([self._power[key] for key in keys]).reshape(-1, 2)
        return Prediction(both[:, 0], both[:, 1])

    def predicted(self, places_m: Floats) -> Prediction:
        """Return :meth:`power` as in solvers, which ignore known values at measured positions."""
        power = self.power(places_m)
        # Only known power of one station has no deviation.
        is_known = not power.deviation_db.all()
        if len(self.posteriors) > 1:
            is_known = any(len(known.rows) for known in self.law.known(places_m))
        return self.law.predicted(places_m, search_power) if is_known else power

    def soon(self, places_m: Floats) -> None:
        """Queue `places_m` (n, 2) for the next batch of predictions."""
        for place in np.asarray(places_m, dtype=np.float64):
            if place.tobytes() not in self._power:
                self._soon[place.tobytes()] = place

    @cached_property
    def anticipated(self) -> tuple[ChannelPosterior, ...]:
        """Return each station's posterior given the other robots' measurements."""
        spacing = self.problem.channel.measure_spacing_m
        return anticipated(self.posteriors, self.aim.pending, self.position_m, spacing)

    @cached_property
    def measuring(self) -> MeasuringRule:
        """Return the rule that selects the positions to measure."""
        return MeasuringRule.of(self.anticipated, self.problem.channel.measure_spacing_m)

    @cached_property
    def near_measuring(self) -> MeasuringRule:
        """Return the rule :attr:`measuring`, reduced to measurements within a plan's reach."""
        reach = self.problem.planner.horizon * self.problem.step_length_m
        return self.measuring.near(self.position_m[None], reach)

    @cached_property
    def near_region(self) -> Region:
        """Return the region of the channel map, with a finer grid where a plan can change it."""
        return region_near(self.problem, self.region, self.position_m)

    @cached_property
    def probing(self) -> MeasuringRule:
        """Return the rule that selects the positions at which the robot probes for a connection."""
        # The robot's current position is excluded unless the last step was connected.
        return self._probing if self.history.steps else self._untried(self.position_m[None])

    @cached_property
    def _probing(self) -> MeasuringRule:
        """Return the rule :attr:`probing`, but allow the robot's position at the start of a run."""
        lost = self.history.outage_steps > 0
        return self._untried(self.position_m[None] if lost else np.zeros((0, 2)))

    def _untried(self, here_m: Floats) -> MeasuringRule:
        """Return the rule that excludes probes near lost packets and near `here_m` (k, 2)."""
        # Failures without a measurement were close to a connected measurement.
        known = [
            np.vstack([own.positions_m[own.power_dbm < threshold], here_m])
            for own, threshold in zip(
                (station.measurements for station in self.posteriors),
                self.law.thresholds_dbm,
                strict=True,
            )
        ]
        spacing = max(self.problem.channel.measure_spacing_m, SAME_PLACE_M)
        rule = MeasuringRule(spacing, tuple(known))
        missed = self.history.missed_m
        unmeasured = missed[rule.is_open(missed)]
        if not len(unmeasured):
            return rule
        return MeasuringRule(spacing, tuple(np.vstack([places, unmeasured]) for places in known))

    def probed(self, places_m: Floats, predicted: Floats) -> Floats:
        """Return the probabilities of connection (...) of probes at positions (..., 2)."""
        # One at known connections, zero where a robot would not probe, else `predicted` (...).
        flat = places_m.reshape(-1, 2)
        found = np.where(self._probing.is_open(flat), predicted.reshape(-1), 0.0)
        return np.where(self.law.is_connected(flat), 1.0, found).reshape(predicted.shape)

    @property
    def connected_m(self) -> Floats:
        """Positions (k, 2) known to be connected."""
        return self.law.connected_m

    def chance(self, place_m: Floats) -> float:
        """Return the probability of connection at one position (2,), from a separate prediction."""
        power = search_prediction(self.law, place_m[None])
        threshold = self.problem.stations[0].threshold_dbm
        return float(connection_probability(power.mean_db, power.deviation_db, threshold)[0])

    @property
    def workspace_diagonal_m(self) -> float:
        """Return the length of the diagonal of the workspace bounds."""
        x_min, y_min, x_max, y_max = self.problem.workspace.bounds_m
        return math.hypot(x_max - x_min, y_max - y_min)


def step_context(base: VerifierContext, region: Region, aim: Aim) -> StepContext:
    """Return the step context for a verification context and the objective's external inputs."""
    turns_m = aim.steering_turns_m
    return StepContext(
        **{each.name: getattr(base, each.name) for each in fields(VerifierContext) if each.init},
        region=region,
        aim=aim,
        steering=None if turns_m is None else steering_path(base.problem, base.index, turns_m),
    )
