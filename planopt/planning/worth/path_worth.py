"""What a path is worth: the weighted sum of its terms, from all measurements.

This is what plans are compared by and what is reported. Solvers work with
:mod:`planopt.planning.worth.local_worth`, which is close to it and has derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import connection_probability
from planopt.errors import InputError
from planopt.objectives.expression import expression_values
from planopt.objectives.filter_gain import covariance_gain, information_gain, sampled_gain
from planopt.objectives.mapping import average_reduction, path_information, path_uncertainty
from planopt.objectives.path_loss_learning import path_loss_gain
from planopt.planning.tolerances import STANDSTILL_M
from planopt.planning.worth.expression_inputs import known_inputs
from planopt.planning.worth.link_energy import link_energy_j
from planopt.planning.worth.rule_worth import slack_cost
from planopt.planning.worth.situation import Situation
from planopt.problems.objective import (
    CasadiTerm,
    LearningTerm,
    MappingTerm,
    MotionEnergyTerm,
    Term,
    TrackingTerm,
    TransmissionEnergyTerm,
    UntilConnectedTerm,
)
from planopt.targets.sensor import sensing_information


@dataclass(frozen=True)
class PathWorth:
    """The worth of paths in one situation."""

    situation: Situation

    def __call__(self, path_m: NDArray[np.float64]) -> float:
        """Weighted sum of the terms for a path (N, 2), less the price of its slack."""
        return float(sum(self.by_term(path_m))) - slack_cost(self.situation, path_m)

    def by_term(self, path_m: NDArray[np.float64]) -> tuple[float, ...]:
        """What each term of the objective contributes, its weight included."""
        return tuple(
            term.weight * _value(term, self.situation, path_m)
            for term in self.situation.problem.terms
        )


def _value(term: Term, at: Situation, path_m: NDArray[np.float64]) -> float:
    match term:
        case TrackingTerm():
            return _tracking(term, at, path_m)
        case LearningTerm():
            measured = path_m[at.measuring.takes(path_m)]
            if not len(measured):
                return 0.0
            return sum(
                path_loss_gain(station, measured, at.criterion(term, station))
                for station in at.stations
            )
        case MappingTerm(form="two_layer"):
            return 0.0 if at.steering is None else float(at.steering.gained_m(path_m))
        case MappingTerm():
            return _mapping(term, at, path_m, at.measuring.takes(path_m))
        case MotionEnergyTerm():
            return -motion_energy_j(term, at, path_m)
        case UntilConnectedTerm():
            return -at.charged_distance_m(term, path_m)
        case TransmissionEnergyTerm():
            return -float(link_energy_j(term, at, at.powers(path_m)).sum())
        case CasadiTerm():
            return _expression(term, at, path_m)
        case _:
            raise AssertionError(f"{term.kind} has no value here")


def _tracking(term: TrackingTerm, at: Situation, path_m: NDArray[np.float64]) -> float:
    if term.form == "sampled":
        further = [
            (station, radio.threshold_dbm)
            for station, radio in zip(at.stations[1:], at.problem.stations[1:], strict=True)
        ]
        return sampled_gain(at.posterior, path_m, at.filtered(term), further)
    settings = at.tracking(term)
    power = at.power(path_m)
    chance = connection_probability(power.mean_db, power.deviation_db, settings.threshold_dbm)
    sensing = sensing_information(settings.sensor, path_m, settings.target_m)
    if term.form == "information":
        return float(information_gain(chance, sensing, at.filtered(term)))
    if term.form == "covariance":
        return float(covariance_gain(chance, sensing, at.filtered(term)))
    return float(settings.weight @ (chance * sensing))


def _expression(term: CasadiTerm, at: Situation, path_m: NDArray[np.float64]) -> float:
    known = known_inputs(term, at, len(path_m))
    power = at.power(path_m)
    threshold = at.problem.stations[0].threshold_dbm
    chance = connection_probability(power.mean_db, power.deviation_db, threshold)
    given = known | {
        "positions_m": path_m,
        "mean_db": power.mean_db[:, None],
        "deviation_db": power.deviation_db[:, None],
        "connectivity": chance[:, None],
    }
    each = {name: values[None] for name, values in given.items()}
    value = float(expression_values(term.program, term.steps, each)[0])
    if not np.isfinite(value):
        number = next(n for n, other in enumerate(at.problem.terms) if other is term)
        raise InputError(
            f"is {value:g} for a path that may be driven",
            file=at.problem.file,
            key=f"objective.terms[{number}].program",
            remedy="keep logarithms and quotients away from 0, for every path",
        )
    return value


def _mapping(
    term: MappingTerm, at: Situation, path_m: NDArray[np.float64], taken: NDArray[np.bool_]
) -> float:
    """What the measurements that are taken along a path tell of the map."""
    if not taken.any():
        return 0.0
    if term.form == "path":
        settings = at.uncertainty(term)
        return sum(path_uncertainty(p, path_m, settings, taken) for p in at.stations)
    measured = path_m[taken]
    if term.form == "information":
        return sum(path_information(station, measured) for station in at.stations)
    return sum(
        average_reduction(station, measured, at.near_region, known)
        for station, known in zip(at.stations, at.near_places, strict=True)
    )


def motion_energy_j(term: MotionEnergyTerm, at: Situation, path_m: NDArray[np.float64]) -> float:
    """Return k1 per metre and k2 while moving, in joules (equation 4.14)."""
    lengths = np.linalg.norm(np.diff(np.vstack([at.position_m, path_m]), axis=0), axis=1)
    moving = np.count_nonzero(lengths > STANDSTILL_M) * at.problem.planner.step_s
    return float(term.per_metre_j_m * lengths.sum() + term.power_w * moving)
