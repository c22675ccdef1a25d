"""Term ``tracking``: information on a target from the packets sent along a path."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, Strict

from planopt.arrays import Derivatives, Floats, Indices, add_products
from planopt.channel.kriging import connection_probability
from planopt.errors import InputError
from planopt.objectives.stage_power import connectivity_derivatives
from planopt.objectives.terms.term import NearPath, Paths, Structure, Term, TermContext, TermSetting
from planopt.objectives.tracking import (
    RECOURSE_STEPS,
    STEPS_OF_ESTIMATES,
    Criterion,
    FilteredTracking,
    Retreats,
    Tracking,
    delayed_costs,
    discounted,
    left,
    recourse_costs,
    retreats_of,
)
from planopt.objectives.upper_bounds import Field as DiscField
from planopt.objectives.upper_bounds import StageBounds, UpperBounds, sensing_bounds
from planopt.parts import make_plain
from planopt.targets.information_filter import Sensor, sensing_derivatives, sensing_information

LONGEST_ADDITIVE = 10
"""Longest horizon at which ``auto`` selects ``additive`` with other terms, a chance constraint or
dynamics. Longer additive plans rely on packets sent close to the target, which are often lost."""

TrackingForm = Literal["auto", "additive", "recourse"]

LONGEST_ADDITIVE_OF_ESTIMATES = 1
"""Limit like `LONGEST_ADDITIVE` if packets contain estimates, which ``additive`` undervalues."""


@dataclass(frozen=True)
class TrackingTerm(Term):
    """Information on the target from packets that a path delivers to the station.

    A packet sent at distance r from the predicted target position carries information 1 / g(r),
    with ``g(r) = noise_curvature (r - sweet_spot_m)^2 + noise_floor_m2``.
    """

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
    form: Annotated[
        TrackingForm,
        Field(
            description="additive (sum over steps of P(connected) / variance) or recourse "
            "(covariance of the station's filter; the robot probes the end of the path and leaves "
            "it without a connection). auto: additive for horizon 1, recourse beyond; with "
            "other terms, a chance constraint or dynamics, additive for horizons "
            f"up to {LONGEST_ADDITIVE}, or {LONGEST_ADDITIVE_OF_ESTIMATES} if packets "
            "have estimates."
        ),
    ] = "auto"
    criterion: Annotated[
        Criterion,
        Field(
            description="With form recourse: trace, determinant or norm (largest eigenvalue) of "
            "the covariance of the target's position."
        ),
    ] = "trace"
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
    summary: ClassVar[str] = "Information on a target over a lossy link."
    task: ClassVar[str | None] = "track"

    def __post_init__(self) -> None:
        make_plain(self)

    def planned(self, setting: TermSetting) -> TrackingTerm:
        """Return the term with ``auto`` replaced by the selected form."""
        if self.form != "auto":
            return self
        longest = 1
        if not setting.is_free or setting.has_dynamics:
            longest = LONGEST_ADDITIVE_OF_ESTIMATES if setting.has_estimates else LONGEST_ADDITIVE
        adds = setting.horizon <= longest and self.criterion == "trace"
        return replace(self, form="additive" if adds else "recourse")

    @property
    def structure(self) -> Structure:
        """Return ``stagewise`` for the additive form, which sums over steps, else ``full``."""
        return "full" if self.probes_end else "stagewise"

    @property
    def probes_end(self) -> bool:
        """Return whether the form probes the end of a path for connection."""
        return self.form == "recourse"

    @property
    def sensor(self) -> Sensor:
        """Return the sensor, whose variance is smallest at the distance `sweet_spot_m`."""
        return Sensor(self.noise_curvature, self.noise_floor_m2, self.sweet_spot_m)

    def check(self, setting: TermSetting) -> None:
        """Raise an InputError for a criterion that the form does not support, or zero weights."""
        if self.criterion != "trace" and self.form == "additive":
            raise InputError(
                f'is {self.criterion!r}, which form = "additive" does not support',
                key="criterion",
                remedy='use form = "recourse", or criterion = "trace"',
            )
        if self.step_weights and not any(self.step_weights):
            raise InputError(
                "has only zeros, so that no step counts",
                key="step_weights",
                remedy="give at least one step a weight above 0",
            )

    def settings(self, at: TermContext) -> Tracking:
        """Return the tracking problem of one planning step."""
        target = at.aim.target_m
        if target is None:
            raise AssertionError("a tracking term needs a target")
        return at.once(
            (TrackingTerm, self),
            lambda: Tracking(
                at.law.thresholds_dbm[0], self.sensor, target, self.weights_of(len(target))
            ),
        )

    def weights_of(self, steps: int) -> Floats:
        """Return the step weights ``(steps,)`` of a plan, including the terminal weight."""
        found = self._step_weights_of(steps)
        found[-1] *= self.terminal_weight
        return found

    def _step_weights_of(self, steps: int) -> Floats:
        """Return the step weights without the terminal weight as an array ``(steps,)``."""
        weights = np.array(self.step_weights or (1.0,))
        return weights[np.minimum(np.arange(steps), len(weights) - 1)]

    def value(self, at: TermContext, path_m: Floats) -> float:
        """Return the information, or covariance reduction, from the packets of one path."""
        chance = _chance(at, path_m)
        if self.probes_end:
            return float(self.probe_values(at, path_m[None], chance[None])[0])
        settings = self.settings(at)
        sensing = sensing_information(settings.sensor, path_m, settings.target_m)
        return float(settings.weight @ (chance * sensing))

    def probe_values(self, at: TermContext, paths_m: Floats, chance: Floats) -> Floats:
        """Return the values of paths with recourse, for connection probabilities (c, N)."""
        settings, retreats, others, idle = at.once(
            (TrackingTerm, "probes", self), lambda: self._probing(at)
        )
        costs = recourse_costs if settings.held is None else delayed_costs
        return idle - costs(paths_m, at.probed(paths_m, chance), retreats, others, settings)

    def _probing(self, at: TermContext) -> tuple[FilteredTracking, Retreats, Floats, float]:
        """Return data for recourse: filter, retreats, others' information, cost without packets."""
        own = self._filtered(at)
        target_m = own.tracking.target_m
        places = np.vstack([target_m, *at.aim.pending.planned_m])
        arrives = at.probed(places, _chance(at, places))
        ends = np.cumsum([len(target_m), *map(len, at.aim.pending.planned_m)])
        at_target, *along = np.split(arrives, ends[:-1])
        retreats = retreats_of(at.connected_m, at_target, own, at.step_length_m)
        others = np.zeros(len(target_m))
        for path, chance in zip(at.aim.pending.planned_m, along, strict=True):
            at_last = np.minimum(np.arange(len(target_m)), len(path) - 1)
            sensing = sensing_information(own.tracking.sensor, path[at_last], target_m)
            others += chance[at_last] * sensing
        return own, retreats, others, float(left(0.5 * others, own))

    def _filtered(self, at: TermContext) -> FilteredTracking:
        """Return the tracking problem, extended beyond the horizon, with the station's filter."""
        if at.aim.information is None:
            raise AssertionError("this form of tracking needs the station's filter")
        settings = self.settings(at)
        found = FilteredTracking(
            settings, at.target_motion, at.aim.information, self.criterion, at.aim.held
        ).extended(RECOURSE_STEPS if at.aim.held is None else STEPS_OF_ESTIMATES)
        # The terminal weight applies only to the last step of the horizon.
        steps, count = len(settings.weight), len(found.tracking.weight)
        beyond = self._step_weights_of(count)[steps:]
        found = found.weighted(np.append(settings.weight, beyond))
        return found if at.aim.held is None else discounted(found)

    def values(self, paths: Paths) -> Floats:
        """Return the information or covariance reduction by many paths."""
        if self.probes_end:
            return self.probe_values(paths.at, paths.paths_m, paths.chance)
        settings = self.settings(paths.at)
        # Incremental planners pass paths with fewer steps than the horizon.
        steps = int(paths.paths_m.shape[1])
        sensing = sensing_information(settings.sensor, paths.paths_m, settings.target_m[:steps])
        return (paths.chance * sensing) @ settings.weight[:steps]

    def derivatives(self, path: NearPath) -> Derivatives:
        """Return the additive value per stage with derivatives, also for forms with probes."""
        settings = self.settings(path.at)
        chance = connectivity_derivatives(*path.stage_power, settings.threshold_dbm)
        sensing = sensing_derivatives(settings.sensor, path.places_m, settings.target_m)
        sensed = settings.weight[:, None] * sensing.rows
        rows = sensed[:, :1] * chance.rows
        rows += chance.value[:, None] * sensed
        rows[:, 0] *= 0.5
        add_products(rows[:, 3:], chance.gradient, sensed[:, 1:3])
        return Derivatives.of(rows)

    def stage_reward(
        self, at: TermContext, places_m: Floats, stage: int | Indices, chance: Floats
    ) -> Floats:
        """Return the expected weighted information of a packet sent at each position."""
        settings = self.settings(at)
        reward = sensing_information(settings.sensor, places_m, settings.target_m[stage])
        reward *= chance
        reward *= settings.weight[stage]
        return reward

    def stage_bounds(self, at: TermContext) -> StageBounds | str:
        """Return upper bounds of the form ``additive``; other forms have none."""
        if self.form != "additive":
            return f"without a proven bound for form = {self.form}"
        settings = self.settings(at)

        def reward(stage: int, field: DiscField) -> UpperBounds:
            sensing = sensing_bounds(settings.sensor, settings.target_m[stage], field.discs)
            return field["chance"].times(sensing).scaled(float(settings.weight[stage]))

        return StageBounds(reward)

    def largest_stage_reward(self, at: TermContext) -> float:
        """Return the maximum information of a packet times the largest step weight."""
        heaviest = max(self.step_weights, default=1.0) * max(self.terminal_weight, 1.0)
        return heaviest / self.noise_floor_m2


def _chance(at: TermContext, places_m: Floats) -> Floats:
    """Return the predicted probability of connection at positions (n, 2)."""
    power = at.power(places_m)
    return connection_probability(power.mean_db, power.deviation_db, at.law.thresholds_dbm[0])
