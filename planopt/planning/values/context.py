"""The context of one planning step: belief, state, target, steering, other robots' plans.

Robots of a team plan one after the other. Each knows the plans made before its own, and where the
others have been. Their measurements count as made, with the predicted power as their value: that
changes no mean, and reduces variances exactly as a real measurement would, because variances do not
depend on the value. The information of a path given that of the others is then

    F(path | others) = F(path and others) - F(others),

so that the values of all robots, each given those before it, add up to that of the team.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior, with_expected
from planopt.channel.prediction import Prediction, connection_probability
from planopt.objectives.measuring import SAME_PLACE_M, KnownLinks, MeasuringRule, known_links
from planopt.objectives.moments import Region
from planopt.objectives.terms.term import Structure
from planopt.objectives.tracking import Held
from planopt.planning.proof.context import VerifierContext, search_power, search_prediction
from planopt.planning.tolerances import STANDSTILL_M
from planopt.planning.values.exploration import explores, region_near
from planopt.planning.values.steered_path import SteeringWay
from planopt.problems.problem import Problem
from planopt.targets.information_filter import TargetModel

MOST_DRIVEN = 256
"""Maximum number of places visited by other robots that count, the nearest ones: farther ones have
no influence on reachable places."""


@dataclass(frozen=True, eq=False)
class Pending:
    """Positions where the other robots measure."""

    # (N, 2) each: the places after each step of the plans that count
    planned_m: tuple[NDArray[np.float64], ...] = ()
    # (k, 2) where the others have been after the steps of the run so far
    driven_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))


NOTHING_PENDING = Pending()


def anticipated(
    posteriors: Sequence[ChannelPosterior],
    pending: Pending,
    position_m: NDArray[np.float64],  # (2,) where the robot is
    spacing_m: float,
) -> tuple[ChannelPosterior, ...]:
    """Return the belief of each station's channel once the others' measurements are known."""
    away = np.linalg.norm(pending.driven_m - position_m, axis=1)
    near = np.sort(np.argsort(away, kind="stable")[:MOST_DRIVEN])
    places = np.vstack([pending.driven_m[near], *pending.planned_m])
    if len(places):
        taken = MeasuringRule.of(posteriors, spacing_m).takes(places[None])[0]
        places = places[taken]
    if not len(places):
        return tuple(posteriors)
    return tuple(with_expected(posterior, places) for posterior in posteriors)


def places_of_others(driven_m: Sequence[NDArray[np.float64]], number: int) -> NDArray[np.float64]:
    """Return the places (k, 2) of all robots but `number`, robot after robot."""
    others = [places for other, places in enumerate(driven_m) if other != number]
    return np.vstack([np.zeros((0, 2)), *others])


def counts_others(problem: Problem) -> bool:
    """Return whether a term counts the measurements of other robots of the team."""
    return problem.planner.coordination == "joint" and any(
        explores(term) or term.probes_end for term in problem.terms
    )


def shares_places(problem: Problem) -> bool:
    """Return whether a measurement or probe at one place changes the value of places near it."""
    return any(term.is_measured or term.steers == "connection" for term in problem.terms)


def structure_of(problem: Problem) -> Structure:
    """Return how the objective value of a path couples its positions."""
    found = {term.structure for term in problem.terms}
    if "full" in found:
        return "full"
    return "chain" if "chain" in found else "stagewise"


def bends_guesses(problem: Problem, *, steered: bool = True) -> bool:
    """Return whether paths in all directions are tried besides those of the lattice.

    That is so for terms that couple the places of a path, unless they have paths of their own: to
    places tried, or along the path that the robot is `steered` along.
    """
    return any(
        term.structure == "full" and not term.probes_end and not (steered and term.steers)
        for term in problem.terms
    )


def target_model(problem: Problem) -> TargetModel:
    """Constant velocity but for white acceleration, alike along both axes; there is a target."""
    deviation = problem.targets[0].acceleration_std_m_s2
    return TargetModel(problem.planner.step_s, deviation**2 * np.eye(2))


@dataclass(frozen=True, eq=False)
class Aim:
    """External inputs of one plan's objective."""

    # (N, 2) where the target was expected at the end of each step; None without target
    target_m: NDArray[np.float64] | None = None
    # (m, 2) the way that the two-layer form steered along: where the robot was, where the way
    # turns, and its end; None if it did not steer
    steering_turns_m: NDArray[np.float64] | None = None
    # (4, 4) J_{t|t} of the station's filter then; None without target
    information: NDArray[np.float64] | None = None
    pending: Pending = NOTHING_PENDING  # Where the other robots measure, as the plan counts it
    # What the robot holds of the target and the station does not know, where packets have estimates
    held: Held | None = None


Made = TypeVar("Made")

if TYPE_CHECKING:
    # What a term may read is a protocol of properties; a cached one counts as such only by name.
    cached_property = property
else:
    from functools import cached_property


@dataclass(frozen=True, eq=False, kw_only=True)
class StepContext(VerifierContext):
    """Everything that the objective value of a path depends on."""

    # (N, 2) where the target is expected at the end of each step; None without target
    target_m: NDArray[np.float64] | None = None
    region: Region  # Where the map is wanted, for the terms that average it
    # The path that the robot is steered along; None if nothing steers, or leads nowhere
    steering: SteeringWay | None = None
    # (4, 4) J_{t|t}, what the station's filter knows; None without target
    information: NDArray[np.float64] | None = None
    pending: Pending = NOTHING_PENDING  # Where the other robots measure
    held: Held | None = None  # The robot's unsent target measurements, where packets have estimates
    _power: dict[bytes, tuple[float, float]] = field(
        default_factory=dict[bytes, tuple[float, float]], init=False, repr=False
    )
    _soon: dict[bytes, NDArray[np.float64]] = field(
        default_factory=dict[bytes, NDArray[np.float64]], init=False, repr=False
    )
    _made: dict[Hashable, Any] = field(default_factory=dict[Hashable, Any], init=False, repr=False)

    def once(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """Return the result of `make`, called once for each key: terms keep their settings here."""
        if key not in self._made:
            self._made[key] = make()
        return cast("Made", self._made[key])

    @property
    def step_s(self) -> float:
        """Duration of a step."""
        return self.problem.planner.step_s

    @property
    def step_length_m(self) -> float:
        """Length of the longest step."""
        return self.problem.step_length_m

    @property
    def standstill_m(self) -> float:
        """Steps up to this length count as standing."""
        return STANDSTILL_M

    @property
    def thresholds_dbm(self) -> tuple[float, ...]:
        """Power from which on each station is connected."""
        return tuple(radio.threshold_dbm for radio in self.problem.stations)

    @property
    def target_motion(self) -> TargetModel:
        """Return how the target moves."""
        return target_model(self.problem)

    def power(self, places_m: NDArray[np.float64]) -> Prediction:
        """Return the prediction of searches at `places_m` (n, 2), made once for each place.

        From many measurements on it is approximate, and depends a little on the places that are
        predicted together; a released plan is valued by itself.
        """
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

    def soon(self, places_m: NDArray[np.float64]) -> None:
        """Predict `places_m` (n, 2) together with the next new places, which is faster."""
        for place in np.asarray(places_m, dtype=np.float64):
            if place.tobytes() not in self._power:
                self._soon[place.tobytes()] = place

    @cached_property
    def anticipated(self) -> tuple[ChannelPosterior, ...]:
        """Return each station's posterior once the others' measurements are known."""
        spacing = self.problem.channel.measure_spacing_m
        return anticipated(self.stations, self.pending, self.position_m, spacing)

    @property
    def others_m(self) -> tuple[NDArray[np.float64], ...]:
        """Places that the others plan to be at."""
        return self.pending.planned_m

    @property
    def stations(self) -> tuple[ChannelPosterior, ...]:
        """Return the posterior of each station's channel."""
        return self.posteriors

    def combined(self, powers: Sequence[Prediction]) -> Prediction:
        """Return the power that connectivity rests on, from each station's prediction."""
        return self.law.combined(powers)

    @cached_property
    def measuring(self) -> MeasuringRule:
        """Return the rule that decides which places are measured."""
        return MeasuringRule.of(self.anticipated, self.problem.channel.measure_spacing_m)

    @cached_property
    def near_measuring(self) -> MeasuringRule:
        """The same for places that a plan can come to."""
        reach = self.problem.planner.horizon * self.problem.step_length_m
        return self.measuring.near(self.position_m[None], reach)

    @cached_property
    def near_region(self) -> Region:
        """Return the region of the map, fine where a plan can change anything."""
        return region_near(self.problem, self.region, self.position_m)

    @cached_property
    def probing(self) -> MeasuringRule:
        """Return the rule that decides which places are probed for connection.

        None near measurements without connection: multipath is known there. Nor where the robot
        is, unless its last step was connected, or was before without one: near a measurement with
        connection it takes no other.
        """
        history = self.history
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
        rule = MeasuringRule(spacing, tuple(known))
        unmeasured = history.missed_m[rule.is_open(history.missed_m)]
        if not len(unmeasured):
            return rule
        return MeasuringRule(spacing, tuple(np.vstack([places, unmeasured]) for places in known))

    @cached_property
    def links(self) -> KnownLinks:
        """Places where the robot knows whether it is connected."""
        history = self.history
        return known_links(
            self.stations,
            self.thresholds_dbm,
            history.missed_m,
            self.position_m,
            history.outage_steps == 0 if history.steps else None,
            self.problem.channel.measure_spacing_m,
        )

    def chance(self, place_m: NDArray[np.float64]) -> float:
        """Return the probability of connection at one place (2,), predicted by itself."""
        power = self.combined([search_power(each, place_m[None]) for each in self.stations])
        threshold = self.problem.stations[0].threshold_dbm
        return float(connection_probability(power.mean_db, power.deviation_db, threshold)[0])

    @property
    def workspace_diagonal_m(self) -> float:
        """Return the length from corner to corner of the bounds."""
        x_min, y_min, x_max, y_max = self.problem.workspace.bounds_m
        return math.hypot(x_max - x_min, y_max - y_min)

    @property
    def decorrelation_m(self) -> float:
        """The longest decorrelation distance of the stations' shadowing."""
        return max(station.parameters.decorrelation_m for station in self.stations)


def step_context(base: VerifierContext, region: Region, aim: Aim) -> StepContext:
    """Return the context of a step with the external inputs of its objective, not yet steered."""
    return StepContext(
        base.problem,
        base.index,
        base.posteriors,
        base.state,
        base.moving,
        base.history,
        base.uncertain,
        base.goal_grid,
        region=region,
        target_m=aim.target_m,
        information=aim.information,
        pending=aim.pending,
        held=aim.held,
    )
