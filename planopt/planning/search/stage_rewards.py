"""What it is worth to end a step at a node: exact for terms that add up, a stand-in for others.

Terms that couple the places of a path cannot be searched by dynamic programming. In their place
stands what a place would be worth alone; the path that comes out is only a start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.maps.tile_map import TileMap
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, bound_margin_db, connection_probability
from planopt.planning.search.guide import Guide
from planopt.planning.search.lattice_window import Window
from planopt.planning.search.node_field import NodeField
from planopt.planning.tolerances import MARGIN_PAD_DB
from planopt.planning.worth.link_energy import link_energy_j
from planopt.planning.worth.situation import Situation
from planopt.planning.worth.steering_way import SteeringWay
from planopt.problems.objective import (
    LearningTerm,
    MappingTerm,
    MotionEnergyTerm,
    Term,
    TrackingTerm,
    TransmissionEnergyTerm,
    UntilConnectedTerm,
)
from planopt.problems.problem import Problem
from planopt.targets.sensor import sensing_information

Nodes = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Rows and columns of single nodes."""

EVERYWHERE: Window = slice(None), slice(None)

MISSING_DB_SHARE = 10.0
"""What a missing dB costs, in units of the largest reward of a step. A step that misses at all
costs as much as all steps can gain: no reward is worth it."""


class StageRewards:
    """Rewards of one situation, as the lattice search asks for them.

    Parameters
    ----------
    situation
        What is known.
    field
        Predictions at the nodes, refreshed for the situation.
    guide
        How the rule of connectivity is minded.
    """

    def __init__(self, situation: Situation, field: NodeField, guide: Guide) -> None:
        self._situation = situation
        self._guide = guide
        self._field = field
        shape = field.mean_db.shape
        self._alone: NDArray[np.float64] | None = None
        for term in situation.problem.terms:
            if isinstance(term, LearningTerm | MappingTerm):
                alone = term.weight * _alone(term, situation, field)
                self._alone = alone if self._alone is None else self._alone + alone
        self._largest = self._largest_reward()
        # Nodes that are not free, or out of reach, are left at these.
        self._chance, self._fixed = np.zeros(shape), np.full(shape, -np.inf)
        # The same at steps that nothing is asked of.
        self._unasked = self._fixed if guide.asked.all() else self._fixed.copy()
        self._credit = self._largest * guide.credit
        self._look_at(field.window)

    def __call__(self, stage: int, window: Window) -> NDArray[np.float64]:
        """Reward of ending step `stage` (1..N) at each node of the window."""
        return self._rewards(window, stage - 1)

    def along(self, nodes: NDArray[np.intp]) -> NDArray[np.float64]:
        """Reward of ending step k at the k-th of `nodes` (N, 2), given as (iy, ix); ``(N,)``."""
        return self._rewards((nodes[:, 0], nodes[:, 1]), np.arange(len(nodes)))

    def corrected(self, nodes: NDArray[np.intp]) -> None:
        """Take notice of new predictions in the field, at `nodes` (n, 2)."""
        self._look_at((nodes[:, 0], nodes[:, 1]))

    def _rewards(self, where: Window | Nodes, stage: int | NDArray[np.intp]) -> NDArray[np.float64]:
        reward = np.where(self._guide.asked[stage], self._fixed[where], self._unasked[where])
        if self._credit.any():
            reward += self._credit[stage] * self._chance[where]
        for term in self._situation.problem.terms:
            if isinstance(term, TrackingTerm):
                settings = self._situation.tracking(term)
                sensing = sensing_information(
                    settings.sensor, self._field.grid_m[where], settings.target_m[stage]
                )
                sensing *= self._chance[where]
                sensing *= term.weight * settings.weight[stage]
                reward += sensing
        return reward

    def _look_at(self, where: Window | Nodes) -> None:
        """Turn predictions into what does not depend on the stage."""
        problem = self._situation.problem
        radio = problem.stations[0]
        mean, deviation = self._field.mean_db[where], self._field.deviation_db[where]
        known = np.isfinite(mean)
        chance = connection_probability(mean, deviation, radio.threshold_dbm)
        self._chance[where] = np.where(known, chance, 0.0)
        fixed = np.zeros_like(mean) if self._alone is None else self._alone[where]
        for term in problem.terms:
            fixed = fixed + term.weight * self._by_power(term, where, chance)
        self._unasked[where] = np.where(known, fixed, -np.inf)
        if self._guide.asked.any():
            margin = bound_margin_db(mean, deviation, radio.threshold_dbm, self._guide.level)
            missing = np.maximum(MARGIN_PAD_DB - margin, 0.0)
            cost = MISSING_DB_SHARE * missing + problem.planner.horizon * (missing > 0.0)
            fixed = fixed - self._largest * cost
        self._fixed[where] = np.where(known, fixed, -np.inf)

    def _by_power(
        self, term: Term, where: Window | Nodes, chance: NDArray[np.float64]
    ) -> NDArray[np.float64] | float:
        """What a term gives for the power at a place, whenever it is visited."""
        if isinstance(term, TransmissionEnergyTerm):
            powers = [
                Prediction(station.mean_db[where], station.deviation_db[where])
                for station in self._field.stations
            ]
            return -link_energy_j(term, self._situation, powers)
        if isinstance(term, UntilConnectedTerm):
            # What connection there would save, if it were the only try.
            return self._situation.search(term).beyond_m * chance
        return 0.0

    def _largest_reward(self) -> float:
        """The largest reward of a step."""
        largest = 0.0 if self._alone is None else float(np.nanmax(np.abs(self._alone), initial=0.0))
        for term in self._situation.problem.terms:
            if isinstance(term, TrackingTerm):
                largest += term.weight / term.noise_floor_m2
            each = self._by_power(term, EVERYWHERE, np.ones(1))
            largest += term.weight * float(np.nanmax(np.abs(each), initial=0.0))
        return max(largest, 1e-9)


def move_values(problem: Problem, lengths_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """What moves of these lengths are worth in themselves: their energy, negative.

    Where measurements share what they tell, standing still is not a move: measuring at one place
    twice is worth less than the stand-in says.
    """
    value = np.zeros(len(lengths_m))
    for term in problem.terms:
        if isinstance(term, MotionEnergyTerm):
            moving = np.where(lengths_m > 0.0, problem.planner.step_s, 0.0)
            value -= term.weight * (term.per_metre_j_m * lengths_m + term.power_w * moving)
    if any(term.shares_places for term in problem.terms):
        value[lengths_m == 0.0] = -np.inf
    return value


def _alone(
    term: LearningTerm | MappingTerm, at: Situation, field: NodeField
) -> NDArray[np.float64]:
    """What measuring at each node would be worth if it were the only one; (ny, nx)."""
    if isinstance(term, MappingTerm) and term.form == "two_layer":
        if at.steering is None:
            return np.zeros_like(field.mean_db)
        return -_steered_m(at.steering, field)
    first, *others = [
        _told(term, station, posterior)
        for station, posterior in zip(field.stations, at.stations, strict=True)
    ]
    for other in others:
        first = first + other
    # A node that is measured already brings nothing.
    first[~_is_open(at, field)] = 0.0
    return first


def _steered_m(steering: SteeringWay, field: NodeField) -> NDArray[np.float64]:
    """How far it is from each node to the end of the way; (ny, nx)."""
    if steering.lattice_m is not None:
        return steering.lattice_m
    return steering.distance_m(field.grid_m.reshape(-1, 2)).reshape(field.mean_db.shape)


def _is_open(at: Situation, field: NodeField) -> NDArray[np.bool_]:
    """Whether each node within reach brings a measurement; (ny, nx)."""
    found = np.ones(field.mean_db.shape, dtype=np.bool_)
    near = field.grid_m[field.window]
    found[field.window] = at.near_measuring.is_open(near.reshape(-1, 2)).reshape(near.shape[:2])
    return found


def _told(
    term: LearningTerm | MappingTerm, station: TileMap, posterior: ChannelPosterior
) -> NDArray[np.float64]:
    """What measuring one station at each node would tell; (ny, nx)."""
    variance = station.deviation_db**2
    if isinstance(term, LearningTerm):
        trend, covariance = station.trend, posterior.theta_covariance
        spread = np.einsum("yxi,ij,yxj->yx", trend, covariance, trend)
        latent = np.maximum(variance - spread, 1e-12)
        if term.criterion == "T":
            return np.einsum("yxi,yxi->yx", trend, trend) / latent
        return np.log1p(spread / latent)
    match term.form:
        case "path":
            return np.maximum(variance - term.variance_threshold_db2, 0.0)
        case "information":
            floor = max(posterior.parameters.multipath_std_db, 1e-6)
            return np.log(station.deviation_db / floor)
        case _:
            return variance
