"""Terms that rest on the predictions of single stages, with exact derivatives by the path."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.batch_derivatives import PathDerivatives
from planopt.objectives.expression_casadi import expression_derivatives
from planopt.objectives.filter_derivatives import (
    covariance_gain_derivatives,
    information_gain_derivatives,
)
from planopt.objectives.tracking_derivatives import (
    connectivity_derivatives,
    tracking_reward_derivatives,
)
from planopt.planning.worth.expression_inputs import known_inputs
from planopt.planning.worth.link_energy import link_energy_derivatives
from planopt.planning.worth.serving_stages import StagePower
from planopt.planning.worth.situation import Situation
from planopt.problems.objective import CasadiTerm, TrackingTerm, TransmissionEnergyTerm
from planopt.targets.rounding import Derivatives
from planopt.targets.sensor import sensing_derivatives

StageTerm = TrackingTerm | TransmissionEnergyTerm | CasadiTerm


def stage_term_derivatives(
    term: StageTerm,
    at: Situation,
    places_m: NDArray[np.float64],
    power: StagePower,
    each: Sequence[StagePower],
) -> Derivatives | PathDerivatives:
    """What a term is worth, by stage where it adds up over them.

    Parameters
    ----------
    term
        The term.
    at
        What is known.
    places_m
        ``(N, 2)``.
    power
        Predicted mean and deviation at the places, of several stations of the serving power.
    each
        Of each station's.
    """
    match term:
        case TrackingTerm():
            return _tracking(term, at, places_m, power)
        case TransmissionEnergyTerm():
            energy = link_energy_derivatives(term, at, each)
            return Derivatives(-energy.value, -energy.gradient, -energy.hessian)
        case CasadiTerm():
            return _expression(term, at, places_m, power)


def _tracking(
    term: TrackingTerm,
    at: Situation,
    places_m: NDArray[np.float64],
    power: StagePower,
) -> Derivatives | PathDerivatives:
    settings = at.tracking(term)
    chance = connectivity_derivatives(*power, settings.threshold_dbm)
    sensing = sensing_derivatives(settings.sensor, places_m, settings.target_m)
    if term.form == "additive":
        return tracking_reward_derivatives(chance, sensing, settings.weight)
    if term.form == "information":
        return information_gain_derivatives(chance, sensing, at.filtered(term))
    # Sampled outcomes jump with the path. What the solver climbs in their place is in the same
    # unit; what it returns is sampled again.
    return covariance_gain_derivatives(chance, sensing, at.filtered(term))


def _expression(
    term: CasadiTerm,
    at: Situation,
    places_m: NDArray[np.float64],
    power: StagePower,
) -> PathDerivatives:
    known = known_inputs(term, at, len(places_m))
    straight = np.zeros((len(places_m), 3))
    own = {
        name: Derivatives(
            places_m[:, axis], np.broadcast_to(np.eye(2)[axis], places_m.shape), straight
        )
        for axis, name in enumerate(("x", "y"))
    }
    chance = connectivity_derivatives(*power, at.problem.stations[0].threshold_dbm)
    given = own | {"mean_db": power[0], "deviation_db": power[1], "connectivity": chance}
    return expression_derivatives(term.program, term.steps, given, known)
