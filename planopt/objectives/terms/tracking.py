"""The term ``tracking``: what the packets of a path tell the station of a target."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict

from planopt.channel.prediction import connection_probability
from planopt.errors import InputError
from planopt.objectives.axis_filter import criterion_of, left, removed
from planopt.objectives.filter_derivatives import (
    covariance_gain_derivatives,
    information_gain_derivatives,
)
from planopt.objectives.recourse_estimates import (
    STEPS_OF_ESTIMATES,
    discounted,
    told_later_costs,
)
from planopt.objectives.terms.context import NearPath, Part, Paths, StepContext
from planopt.objectives.terms.term import Structure, Term, TermSetting
from planopt.objectives.tracking import (
    Tracking,
    connectivity_derivatives,
    score_derivatives,
    tracking_reward,
    tracking_reward_derivatives,
)
from planopt.objectives.tracking_filter import (
    Criterion,
    FilteredTracking,
    covariance_gain,
    first_steps,
    information_gain,
    sensing_of,
    unobserved_covariances,
)
from planopt.objectives.tracking_recourse import (
    RECOURSE_STEPS,
    Retreats,
    recourse_costs,
    retreats_of,
)
from planopt.objectives.tracking_scenarios import (
    Stations,
    drawn_errors,
    extended,
    received_from,
    scenario_derivatives,
    scenario_gain,
    scenario_gains,
    solver_draws,
)
from planopt.plain_values import make_plain
from planopt.targets.sensor import Sensor, sensing_derivatives, sensing_information

LONGEST_ADDITIVE = 10
"""Steps up to which ``auto`` is ``additive`` for robots with dynamics: beyond it gambles on packets
beside the target."""

TrackingForm = Literal["auto", "additive", "information", "covariance", "sampled", "recourse"]

LONGEST_ADDITIVE_OF_ESTIMATES = 1
"""The same where packets have estimates: ``additive`` takes them for measurements."""


@dataclass(frozen=True)
class TrackingTerm(Term):
    """The information on the target that packets of a path bring to the station.

    A packet sent at distance r of the target's predicted position has the information 1 / g(r),
    ``g(r) = noise_curvature (r - sweet_spot_m)^2 + noise_floor_m2``.
    """

    # Curvature (a number), least variance in m^2 and best distance in m of the sensor
    noise_curvature: Annotated[
        float,
        Field(
            gt=0,
            le=1e9,
            description="c of the sensor's variance at r metres: "
            "c (r - sweet_spot_m)^2 + noise_floor_m2.",
        ),
    ]
    noise_floor_m2: Annotated[
        float, Field(gt=0, le=1e9, description="Variance in m^2 at the best distance.")
    ]
    sweet_spot_m: Annotated[
        float, Field(ge=0, le=1e6, description="Distance in metres at which the sensor is best.")
    ]
    # auto: additive one step ahead, recourse beyond; sampled for other criteria than the trace;
    # beside other terms or a bound on connectivity, and of robots with inertia or a heading,
    # additive up to `LONGEST_ADDITIVE` steps, one where packets have estimates, and sampled beyond.
    # additive: P(connected) / g(r), summed over the steps. The others follow the station's filter:
    # information bounds the expected gain of information from above, covariance removes covariance
    # as if losses were independent in time, sampled averages over joint losses, recourse takes the
    # end of a path for a place that is tried.
    form: Annotated[
        TrackingForm,
        Field(
            description="additive (P(connected) over the variance, summed over steps), or by the "
            "station's filter: information (an upper bound), covariance (losses as if independent "
            "in time), sampled (joint losses) or recourse (places are tried); auto: additive one "
            "step ahead, recourse beyond, sampled for other criteria than trace; beside other "
            "terms or a bound, and for robots with dynamics, additive up to a horizon of "
            f"{LONGEST_ADDITIVE}, where packets have estimates of {LONGEST_ADDITIVE_OF_ESTIMATES}, "
            "and sampled beyond."
        ),
    ] = "auto"
    # Of the form sampled: steps beyond the horizon, and what counts of the covariance of the
    # target's position
    beyond_steps: Annotated[
        int,
        Field(
            ge=0,
            le=100,
            description="With form sampled: steps beyond the horizon that count as well, the robot "
            "standing at the end of its path while the target moves on (a number).",
        ),
    ] = 0
    criterion: Annotated[
        Criterion,
        Field(
            description="With form sampled: trace, determinant or norm (largest eigenvalue) of the "
            "covariance of the target's position."
        ),
    ] = "trace"
    # Weights of the steps ahead, the last one for all further steps, and a factor of the last step
    # of a plan
    step_weights: Annotated[
        tuple[Annotated[float, Field(ge=0, le=1e9)], ...],
        Strict(False),
        Field(
            max_length=500,
            description="Weights of the steps ahead (numbers); the last one holds for all further "
            "steps. Empty: all one.",
        ),
    ] = ()
    terminal_weight: Annotated[
        float,
        Field(gt=0, le=1e9, description="Factor of the last step of a plan, a terminal reward."),
    ] = 1.0

    kind: ClassVar[str] = "tracking"
    summary: ClassVar[str] = "Track a target over a lossy link."
    task: ClassVar[str | None] = "track"

    def __post_init__(self) -> None:
        make_plain(self)

    def planned(self, setting: TermSetting) -> TrackingTerm:
        """Return the term with the form that ``auto`` is."""
        if self.form != "auto":
            return self
        if self.criterion != "trace":
            return replace(self, form="sampled")
        if setting.horizon > 1 and setting.is_free and not setting.has_dynamics:
            return replace(self, form="recourse")
        longest = LONGEST_ADDITIVE_OF_ESTIMATES if setting.has_estimates else LONGEST_ADDITIVE
        return replace(self, form="sampled" if setting.horizon > longest else "additive")

    @property
    def follows_filter(self) -> bool:
        """Return whether the value is of the station's filter, and no sum over steps."""
        return self.form not in ("auto", "additive")

    @property
    def structure(self) -> Structure:
        """Steps add up in the additive form only."""
        return "full" if self.follows_filter else "stagewise"

    @property
    def needs_power(self) -> bool:
        """A packet arrives with the probability of connection."""
        return True

    @property
    def bends_starts(self) -> bool:
        """The lattice's rewards saturate as the sampled value does; tries have their own ways."""
        return self.form not in ("sampled", "recourse")

    @property
    def tries_places(self) -> bool:
        """Return whether the end of a path is a try."""
        return self.form == "recourse"

    @property
    def can_be_polished(self) -> bool:
        """A try succeeds or fails where it ends: there is nothing to climb."""
        return self.form != "recourse"

    @property
    def counts_others(self) -> bool:
        """The filter is told less by a packet beside another; in the additive form all add up."""
        return self.follows_filter

    @property
    def pays_standing(self) -> bool:
        """The target moves on, and packets tell of it from where the robot is."""
        return True

    @property
    def sensor(self) -> Sensor:
        """Its variance grows away from the best distance."""
        return Sensor(self.noise_curvature, self.noise_floor_m2, self.sweet_spot_m)

    def check(self, setting: TermSetting) -> None:
        """The criterion is one of the form, and some step counts."""
        if self.criterion != "trace" and self.form not in ("auto", "sampled", "recourse"):
            raise InputError(
                f"{self.criterion} is no criterion of the form {self.form}",
                key="criterion",
                remedy='use form = "sampled", or criterion = "trace"',
            )
        if self.step_weights and not any(self.step_weights):
            raise InputError(
                "no step counts", key="step_weights", remedy="give a step a weight above 0"
            )

    def settings(self, at: StepContext) -> Tracking:
        """Return the target and the sensor of one step."""
        target = at.target_m
        if target is None:
            raise AssertionError("a tracking term needs a target")
        return at.once(
            (TrackingTerm, self),
            lambda: Tracking(
                at.thresholds_dbm[0], self.sensor, target, self.weights_of(len(target))
            ),
        )

    def weights_of(self, steps: int) -> NDArray[np.float64]:
        """Return the weights of a plan of so many steps; ``(steps,)``."""
        found = self._step_weights_of(steps)
        found[-1] *= self.terminal_weight
        return found

    def _step_weights_of(self, steps: int) -> NDArray[np.float64]:
        """Return the weights of so many steps without that of the last one as such."""
        given = np.array(self.step_weights or (1.0,))
        return given[np.minimum(np.arange(steps), len(given) - 1)]

    def filtered(self, at: StepContext) -> FilteredTracking:
        """Return the same with the station's filter, for the forms that follow it."""
        if not at.others_m:
            return self._alone(at)
        others = at.once((TrackingTerm, "others", self), lambda: self._others(at))
        return replace(self._alone(at), others=others)

    def _alone(self, at: StepContext) -> FilteredTracking:
        """Return the same without the packets of others."""
        if at.information is None:
            raise AssertionError("this form of tracking needs what the station knows")
        return FilteredTracking(
            self.settings(at), at.target_motion, at.information, None, self.criterion, at.held
        )

    def _others(self, at: StepContext) -> NDArray[np.float64]:
        """Chance and information of the packets that the other robots plan to send; (2, N, m)."""
        settings = self.settings(at)
        each: list[NDArray[np.float64]] = []
        for path in at.others_m:
            sensing = sensing_information(settings.sensor, path, settings.target_m)
            each.append(np.stack([_chance(at, path), sensing]))
        return np.stack(each, axis=-1)

    def value(self, at: StepContext, path_m: NDArray[np.float64]) -> float:
        """Return the information, or the covariance removed, of one path's packets."""
        if self.form == "sampled":
            others, settings = list(at.others_m), self.beyond(at)
            alone = at.once(
                (TrackingTerm, "alone", self),
                lambda: scenario_gain(_stations(at), others, settings) if others else 0.0,
            )
            return scenario_gain(_stations(at), [*others, path_m], settings) - alone
        settings = self.settings(at)
        chance = _chance(at, path_m)
        if self.form == "recourse":
            return float(self.tried_values(at, path_m[None], chance[None])[0])
        sensing = sensing_information(settings.sensor, path_m, settings.target_m)
        if self.form == "information":
            return float(information_gain(chance, sensing, self.filtered(at)))
        if self.form == "covariance":
            return float(covariance_gain(chance, sensing, self.filtered(at)))
        return float(settings.weight @ (chance * sensing))

    def beyond(self, at: StepContext, steps: int | None = None) -> FilteredTracking:
        """Return the station's filter for all steps, or the first ones, and those beyond."""
        filtered = self._alone(at)
        if steps is not None:
            filtered = first_steps(filtered, steps)
        return self._longer(filtered, self.beyond_steps)

    def _longer(self, settings: FilteredTracking, beyond: int) -> FilteredTracking:
        """Return the same for more steps, weighted as further ones of a plan."""
        found, steps = extended(settings, beyond), len(settings.tracking.weight)
        weight = found.tracking.weight.copy()
        weight[steps:] = self._step_weights_of(len(weight))[steps:]
        return replace(found, tracking=replace(found.tracking, weight=weight))

    def _ranked(self, paths: Paths) -> NDArray[np.float64]:
        """Values of many paths of the form ``sampled``."""
        at, (count, steps) = paths.at, paths.shape
        settings, others = self.beyond(at, steps), [path[:steps] for path in at.others_m]
        errors = drawn_errors(_stations(at), others)[:, :, : solver_draws(settings)]
        told = received_from(_stations(at), others, errors, settings)
        scores = (paths.power.mean_db - at.thresholds_dbm[0]) / paths.power.deviation_db
        covariance = paths.stations[0].universal
        found = scenario_gains(
            scores.reshape(count, steps), covariance, paths.ways_m, told, settings
        )
        return found - removed(told, settings)

    def tried_values(
        self, at: StepContext, ways_m: NDArray[np.float64], chance: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the values of the form ``recourse`` by chances as predicted."""

        def made() -> tuple[FilteredTracking, Retreats, NDArray[np.float64], float]:
            own = self._alone(at)
            if own.held is None:
                own = self._longer(own, RECOURSE_STEPS)
            else:
                own = discounted(self._longer(own, STEPS_OF_ESTIMATES))
            target_m = own.tracking.target_m
            places = np.vstack([target_m, *at.others_m])
            arrives = at.links.chances(places, _chance(at, places))
            ends = np.cumsum([len(target_m), *map(len, at.others_m)])
            beside, *told = np.split(arrives, ends[:-1])
            retreats = retreats_of(at.links.connected_m, beside, own, at.step_length_m)
            others = np.zeros(len(target_m))
            for path, chance in zip(at.others_m, told, strict=True):
                at_last = np.minimum(np.arange(len(target_m)), len(path) - 1)
                sensing = sensing_information(own.tracking.sensor, path[at_last], target_m)
                others += chance[at_last] * sensing
            return own, retreats, others, float(left(0.5 * others, own))

        settings, retreats, others, idle = at.once((TrackingTerm, "tried", self), made)
        known = at.links.chances(ways_m, chance)
        costs = recourse_costs if settings.held is None else told_later_costs
        return idle - costs(ways_m, known, retreats, others, settings)

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the same of many paths."""
        if self.form == "sampled":
            return self._ranked(paths)
        if self.form == "recourse":
            return self.tried_values(paths.at, paths.ways_m, paths.chance)
        settings, chance = self.settings(paths.at), paths.chance
        if self.follows_filter:
            filtered = first_steps(self.filtered(paths.at), paths.shape[1])
            gain = information_gain if self.form == "information" else covariance_gain
            return gain(chance, sensing_of(paths.ways_m, filtered), filtered)
        return np.sum(
            [
                tracking_reward(chance[:, k], paths.ways_m[:, k], k, settings)
                for k in range(paths.shape[1])
            ],
            axis=0,
        )

    def derivatives(self, path: NearPath) -> Part:
        """Return the value by stages, or of the whole path where the filter couples them."""
        if self.form == "sampled":
            return self._derivatives(path)
        settings = self.settings(path.at)
        chance = connectivity_derivatives(*path.stage_power, settings.threshold_dbm)
        sensing = sensing_derivatives(settings.sensor, path.places_m, settings.target_m)
        if not self.follows_filter:
            return tracking_reward_derivatives(chance, sensing, settings.weight)
        if self.form == "information":
            return information_gain_derivatives(chance, sensing, self.filtered(path.at))
        return covariance_gain_derivatives(chance, sensing, self.filtered(path.at))

    def _derivatives(self, path: NearPath) -> Part:
        """Return the value of the form ``sampled`` over fewer draws, with derivatives."""
        at, settings = path.at, self.beyond(path.at)

        def drawn() -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
            errors = drawn_errors(_stations(at), [*at.others_m, path.about_m])
            errors = errors[:, :, : solver_draws(settings)]
            told = received_from(_stations(at), at.others_m, errors[:, :-1], settings)
            return errors[:, -1], told, float(removed(told, settings))

        errors, told, alone = at.once((TrackingTerm, self, path.about_m.tobytes()), drawn)
        scores = [
            score_derivatives(*power, threshold)
            for power, threshold in zip(path.each, at.thresholds_dbm, strict=True)
        ]
        found = scenario_derivatives(scores, errors, told, path.places_m, settings)
        return replace(found, value=found.value - alone)

    def stage_reward(
        self,
        at: StepContext,
        places_m: NDArray[np.float64],
        stage: int | NDArray[np.intp],
        chance: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return the expected information of one packet, in the additive form.

        In the form ``sampled`` how much it lessens the criterion of what the station knows at that
        step without packets of the robot.
        """
        settings = self.settings(at)
        if self.form == "sampled":
            variance = at.once((TrackingTerm, "variance", self), lambda: self._unobserved_m2(at))
            told = sensing_information(settings.sensor, places_m, settings.target_m[stage])
            told *= 0.5 * variance[stage]
            left = criterion_of(variance[stage] / (1.0 + told), self.criterion)
            removed_here = criterion_of(variance[stage], self.criterion) - left
            return removed_here * (settings.weight[stage] * chance)
        reward = sensing_information(settings.sensor, places_m, settings.target_m[stage])
        reward *= chance
        reward *= settings.weight[stage]
        return reward

    def _unobserved_m2(self, at: StepContext) -> NDArray[np.float64]:
        """Variance of a coordinate after each step without packets of the robot; ``(N,)``."""
        covariances = unobserved_covariances(self.filtered(at))
        variance = 0.5 * np.trace(covariances[:, :2, :2], axis1=1, axis2=2)
        return np.minimum(variance, 0.5 / self.noise_floor_m2)

    def largest_stage_reward(self, at: StepContext) -> float:
        """Return the information of a packet from the best distance at the heaviest step."""
        most = 1.0 / self.noise_floor_m2
        if self.criterion == "determinant":
            most = max(most, 0.25 * most**2)
        return most * max(self.step_weights, default=1.0) * max(self.terminal_weight, 1.0)


def _chance(at: StepContext, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Predicted chance of connection at places (n, 2)."""
    power = at.power(places_m)
    return connection_probability(power.mean_db, power.deviation_db, at.thresholds_dbm[0])


def _stations(at: StepContext) -> Stations:
    return list(zip(at.stations, at.thresholds_dbm, strict=True))
