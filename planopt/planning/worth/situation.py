"""What one step of planning a sum of terms knows: the channel, the robot's place, the target."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, connection_probability
from planopt.objectives.batch import KnownPlaces, known_places
from planopt.objectives.energy import Radio
from planopt.objectives.mapping import Region, Uncertainty
from planopt.objectives.measuring import SAME_PLACE_M, MeasuringRule
from planopt.objectives.path_loss_learning import Criterion, goal_criterion
from planopt.objectives.tracking import Tracking
from planopt.objectives.tracking_filter import FilteredTracking
from planopt.objectives.until_connected import LATER, Search, charged_distance_m, search_length_m
from planopt.planning.proof.circumstances import Circumstances
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.proof.serving import Serving
from planopt.planning.worth.region import region_near
from planopt.planning.worth.steering_way import SteeringWay
from planopt.planning.worth.target_model import target_model
from planopt.problems.objective import (
    LearningTerm,
    MappingTerm,
    TrackingTerm,
    TransmissionEnergyTerm,
    UntilConnectedTerm,
)
from planopt.problems.problem import Problem
from planopt.targets.sensor import Sensor


@dataclass(frozen=True, eq=False)
class Situation:
    """Everything that the worth of a path depends on.

    Attributes
    ----------
    problem
        With the one robot that is planned for.
    posterior
        What is believed of the channel; of several stations, the first one's.
    position_m
        ``(2,)`` where the robot is.
    target_m
        ``(N, 2)`` where the target is expected at the end of each step; None without target.
    region
        Where the map is wanted, for the terms that look at the workspace.
    steering
        The way that the two-layer form steers along, or that leads to a try for connection; None
        if there is no such place, or nothing steers.
    information
        ``(4, 4)`` J_{t|t}, what the station's filter knows; None without target.
    circumstances
        What else is known at the step.
    """

    problem: Problem
    posterior: ChannelPosterior
    position_m: NDArray[np.float64]
    target_m: NDArray[np.float64] | None
    region: Region
    steering: SteeringWay | None = None
    information: NDArray[np.float64] | None = None
    circumstances: Circumstances = field(default_factory=Circumstances)
    _power: dict[bytes, tuple[float, float]] = field(
        default_factory=dict[bytes, tuple[float, float]], init=False, repr=False
    )
    _soon: dict[bytes, NDArray[np.float64]] = field(
        default_factory=dict[bytes, NDArray[np.float64]], init=False, repr=False
    )
    _tracking: dict[TrackingTerm, Tracking] = field(
        default_factory=dict[TrackingTerm, Tracking], init=False, repr=False
    )

    _after: dict[UntilConnectedTerm, float] = field(
        default_factory=dict[UntilConnectedTerm, float], init=False, repr=False
    )

    _charged: dict[tuple[UntilConnectedTerm, bytes], float] = field(
        default_factory=dict[tuple[UntilConnectedTerm, bytes], float], init=False, repr=False
    )

    def power(self, places_m: NDArray[np.float64]) -> Prediction:
        """Prediction at `places_m` (n, 2) as searches look at it, made once for each place.

        Beyond some number of measurements it is a little off, by how much depends on which places
        it was made with: what is released is valued by itself.
        """
        keys = [place.tobytes() for place in np.asarray(places_m, dtype=np.float64)]
        new = {
            key: place for key, place in zip(keys, places_m, strict=True) if key not in self._power
        }
        if new:
            new |= self._soon
            self._soon.clear()
            found = search_prediction(
                self.posterior, np.array(list(new.values())), self.circumstances.broad
            )
            values = zip(found.mean_db.tolist(), found.deviation_db.tolist(), strict=True)
            self._power.update(zip(new, values, strict=True))
        both = np.array([self._power[key] for key in keys]).reshape(-1, 2)
        return Prediction(both[:, 0], both[:, 1])

    def soon(self, places_m: NDArray[np.float64]) -> None:
        """Predict `places_m` (n, 2) with the next new places: near ones share measurements."""
        for place in np.asarray(places_m, dtype=np.float64):
            if place.tobytes() not in self._power:
                self._soon[place.tobytes()] = place

    @property
    def stations(self) -> tuple[ChannelPosterior, ...]:
        """What is believed of each station's channel."""
        broad = self.circumstances.broad
        return broad.posteriors if isinstance(broad, Serving) else (self.posterior,)

    def law(self, powers: Sequence[Prediction]) -> Prediction:
        """What connectivity rests on, from predictions of each station's power."""
        broad = self.circumstances.broad
        return broad.law(powers) if isinstance(broad, Serving) else powers[0]

    def powers(self, places_m: NDArray[np.float64]) -> list[Prediction]:
        """Predictions of each station's power at `places_m` (n, 2), as searches look at them."""
        if not isinstance(self.circumstances.broad, Serving):
            return [self.power(places_m)]
        return [search_prediction(station, places_m) for station in self.stations]

    @cached_property
    def measuring(self) -> MeasuringRule:
        """Which places bring a measurement."""
        return MeasuringRule.of(self.stations, self.problem.channel.measure_spacing_m)

    @cached_property
    def near_measuring(self) -> MeasuringRule:
        """The same for places that a plan can come to."""
        reach = self.problem.planner.horizon * self.problem.step_length_m
        return self.measuring.near(self.position_m[None], reach)

    @cached_property
    def near_region(self) -> Region:
        """Where the map is wanted, fine where a plan can change anything."""
        return region_near(self.problem, self.region, self.position_m)

    @cached_property
    def near_places(self) -> tuple[KnownPlaces | None, ...]:
        """The places of `near_region` prepared for each station; None where it has no factor."""
        return tuple(
            known_places(station, self.near_region.grid_m) if station.has_factor else None
            for station in self.stations
        )

    def tracking(self, term: TrackingTerm) -> Tracking:
        """The settings of a tracking term."""
        if self.target_m is None:
            raise AssertionError("a tracking term needs a target")
        if term not in self._tracking:
            self._tracking[term] = Tracking(
                self.problem.stations[0].threshold_dbm,
                Sensor(term.noise_curvature, term.noise_floor_m2, term.sweet_spot_m),
                self.target_m,
            )
        return self._tracking[term]

    def filtered(self, term: TrackingTerm) -> FilteredTracking:
        """The settings of a tracking term that follows the station's filter."""
        if self.information is None:
            raise AssertionError("this form of tracking needs what the station knows")
        model = target_model(self.problem)
        return FilteredTracking(self.tracking(term), model, self.information)

    def search(self, term: UntilConnectedTerm) -> Search:
        """The settings of a search for connection that ends where a try at the way's end failed.

        Where the robot is is no try (:attr:`tries`), and needs no condition.
        """
        x, y = self.position_m
        if term not in self._after:
            self._after[term] = self._after_try_m(term)
        return Search(
            (float(x), float(y)),
            self.problem.stations[0].threshold_dbm,
            disconnected_now=False,
            beyond_m=self._after[term],
            further_thresholds_dbm=tuple(r.threshold_dbm for r in self.problem.stations[1:]),
        )

    @cached_property
    def tries(self) -> MeasuringRule:
        """Which places a search for connection tries.

        None near measurements without connection: multipath is known there. Nor where the robot
        is, unless its last step was connected.
        """
        history = self.circumstances.history
        lost = history.steps == 0 or history.outage_steps > 0
        here = self.position_m[None] if lost else np.zeros((0, 2))
        known = [
            np.vstack([own.positions_m[own.power_dbm < radio.threshold_dbm], here])
            for own, radio in zip(
                (station.measurements for station in self.stations),
                self.problem.stations,
                strict=True,
            )
        ]
        spacing = max(self.problem.channel.measure_spacing_m, SAME_PLACE_M)
        return MeasuringRule(spacing, tuple(known))

    def _chance(self, place_m: NDArray[np.float64]) -> float:
        """Chance of a connection at a place (2,)."""
        power = self.law([search_prediction(each, place_m[None]) for each in self.stations])
        threshold = self.problem.stations[0].threshold_dbm
        return float(connection_probability(power.mean_db, power.deviation_db, threshold)[0])

    def _after_try_m(self, term: UntilConnectedTerm) -> float:
        """What is expected beyond the end of the way that the robot is steered along, in metres.

        (1 - P) (L + R) of :func:`planopt.objectives.until_connected.search_length_m`, from the way
        alone, so that a saved plan has the same.
        """
        way = self.steering
        if way is None:
            return self.workspace_diagonal_m if term.beyond_m is None else term.beyond_m
        chance = np.array([self._chance(way.end_m)])
        after = self.search_length_m(term, way.rest_m[:1], chance) - way.rest_m[0]
        return max(float(after[0]), 0.0)

    def search_length_m(
        self, term: UntilConnectedTerm, length_m: NDArray[np.float64], chance: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the expected length of a search by tries at places so far away; ``(k,)``.

        :func:`planopt.objectives.until_connected.search_length_m`, or D + (1 - P) `beyond_m`.
        """
        if term.beyond_m is not None:
            return length_m + (1.0 - chance) * term.beyond_m
        return search_length_m(length_m, chance, self.decorrelation_m, self.workspace_diagonal_m)

    def beyond_m(
        self, term: UntilConnectedTerm, ends_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """What a plan is charged that ends at each of some places (n, 2) without connection; (n,).

        The way that is left to where the robot is steered to, and what is expected from there.
        """
        after = np.full(len(ends_m), self.search(term).beyond_m)
        return after if self.steering is None else after + LATER * self.steering.distance_m(ends_m)

    def charged_distance_m(self, term: UntilConnectedTerm, path_m: NDArray[np.float64]) -> float:
        """Return what a search along a path (N, 2) is charged, integrated once for each path."""
        key = term, path_m.tobytes()
        if key not in self._charged:
            beyond = float(self.beyond_m(term, path_m[-1:])[0])
            settings = replace(self.search(term), beyond_m=beyond)
            self._charged[key] = charged_distance_m(
                self.posterior, path_m, settings, self.stations[1:], self.tries.takes(path_m)
            )
        return self._charged[key]

    @property
    def workspace_diagonal_m(self) -> float:
        """From corner to corner of the bounds."""
        x_min, y_min, x_max, y_max = self.problem.workspace.bounds_m
        return math.hypot(x_max - x_min, y_max - y_min)

    @property
    def decorrelation_m(self) -> float:
        """The longest decorrelation distance of the stations' shadowing."""
        return max(station.parameters.decorrelation_m for station in self.stations)

    def radio(self, term: TransmissionEnergyTerm, station: int = 0) -> Radio:
        """The settings of a link; the predicted gain is that of the station's own sending."""
        return Radio(
            term.bits_per_symbol,
            term.bit_error_rate,
            term.noise_dbm,
            self.problem.stations[station].transmit_power_dbm,
            term.bits / (term.bits_per_symbol * term.bandwidth_hz),
        )

    def criterion(self, term: LearningTerm, station: ChannelPosterior) -> Criterion:
        """The settings of a learning term, for one of the stations."""
        if term.criterion == "V":
            return goal_criterion(station, self.region.grid_m, self.region.weight)
        return Criterion(term.criterion)

    def uncertainty(self, term: MappingTerm) -> Uncertainty:
        """The settings of a mapping term."""
        x, y = self.position_m
        return Uncertainty(
            term.variance_threshold_db2, term.closeness_per_m, start_m=(float(x), float(y))
        )
