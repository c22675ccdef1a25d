"""Each term of the objective, of many ways at once: the formulae of its own file, batched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import connection_probability
from planopt.objectives.energy import expected_transmit_power_w
from planopt.objectives.expression import expression_values
from planopt.objectives.filter_gain import (
    covariance_gain,
    first_steps,
    information_gain,
    sensing_of,
)
from planopt.objectives.passage_programme import charged_distances_m
from planopt.objectives.path_loss_learning import theta_information
from planopt.objectives.tracking import tracking_reward
from planopt.planning.search.way_batch import WayBatch
from planopt.planning.tolerances import STANDSTILL_M
from planopt.planning.worth.expression_inputs import known_inputs
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


def ranked_value(term: Term, at: Situation, batch: WayBatch) -> NDArray[np.float64]:
    """What `term` is worth of each way, ``(c,)``."""
    match term:
        case TrackingTerm():
            return _tracking(term, at, batch)
        case LearningTerm():
            return _learning(term, at, batch)
        case MappingTerm():
            return _mapping(term, at, batch)
        case MotionEnergyTerm():
            legs = legs_m(at, batch.ways_m)
            moving = (legs > STANDSTILL_M).sum(axis=1) * at.problem.planner.step_s
            return -(term.per_metre_j_m * legs.sum(axis=1) + term.power_w * moving)
        case UntilConnectedTerm():
            return _until_connected(term, at, batch)
        case TransmissionEnergyTerm():
            power, radio = batch.power, at.radio(term)
            each = expected_transmit_power_w(power.mean_db, power.deviation_db, radio)
            return -radio.send_s * each.reshape(batch.shape).sum(axis=1)
        case CasadiTerm():
            return _expression(term, at, batch)


def _tracking(term: TrackingTerm, at: Situation, batch: WayBatch) -> NDArray[np.float64]:
    settings = at.tracking(term)
    power = batch.power
    chance = connection_probability(power.mean_db, power.deviation_db, settings.threshold_dbm)
    chance = chance.reshape(batch.shape)
    if term.form != "additive":
        filtered = first_steps(at.filtered(term), batch.shape[1])
        # Sampling joint losses of every way would be dear: what is chosen is sampled afterwards.
        gain = information_gain if term.form == "information" else covariance_gain
        return gain(chance, sensing_of(batch.ways_m, filtered), filtered)
    return np.sum(
        [
            tracking_reward(chance[:, k], batch.ways_m[:, k], k, settings)
            for k in range(batch.shape[1])
        ],
        axis=0,
    )


def _until_connected(
    term: UntilConnectedTerm, at: Situation, batch: WayBatch
) -> NDArray[np.float64]:
    settings = at.search(term)
    above = batch.power.mean_db.reshape(batch.shape) - settings.threshold_dbm
    legs = legs_m(at, batch.ways_m)
    return -charged_distances_m(above, batch.universal, legs, settings.beyond_m)


def _expression(term: CasadiTerm, at: Situation, batch: WayBatch) -> NDArray[np.float64]:
    """Ways for which the expression has no finite value come last."""
    power = batch.power
    threshold = at.problem.stations[0].threshold_dbm
    chance = connection_probability(power.mean_db, power.deviation_db, threshold)
    known = known_inputs(term, at, batch.shape[1])
    given = {"positions_m": batch.ways_m} | {
        name: np.broadcast_to(values, (batch.shape[0], *values.shape))
        for name, values in known.items()
    }
    for name, values in (
        ("mean_db", power.mean_db),
        ("deviation_db", power.deviation_db),
        ("connectivity", chance),
    ):
        given[name] = values.reshape(*batch.shape, 1)
    found = expression_values(term.program, term.steps, given)
    return np.where(np.isfinite(found), found, -np.inf)


def _learning(term: LearningTerm, at: Situation, batch: WayBatch) -> NDArray[np.float64]:
    criterion = at.criterion(term)
    whitened = np.linalg.solve(batch.covariance, batch.trend)
    gained = batch.trend.transpose(0, 2, 1) @ whitened
    before = None if criterion.kind == "T" else theta_information(at.posterior)
    return criterion.value(gained, before) - criterion.value(np.zeros((2, 2)), before)


def _mapping(term: MappingTerm, at: Situation, batch: WayBatch) -> NDArray[np.float64]:
    match term.form:
        case "two_layer":
            if at.steering_m is None:
                return np.zeros(batch.shape[0])
            start = float(np.linalg.norm(at.position_m - at.steering_m))
            return (start - np.linalg.norm(batch.ways_m - at.steering_m, axis=2)).sum(axis=1)
        case "path":
            _, excess, near = path_form_parts(term, at, batch)
            return (excess * near).sum(axis=1)
        case "information":
            diagonal = np.diagonal(batch.factor, axis1=1, axis2=2)
            return np.log(diagonal / batch.channel.parameters.multipath_std_db).sum(axis=1)
        case "average":
            return _average(batch)


def path_form_parts(
    term: MappingTerm, at: Situation, batch: WayBatch
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """L_ii^2, what of it is above the threshold, and psi of the way there; each ``(c, N)``."""
    settings = at.uncertainty(term)
    variance = np.diagonal(batch.factor, axis1=1, axis2=2) ** 2
    near = np.exp(-settings.decay_per_m * np.cumsum(legs_m(at, batch.ways_m), axis=1))
    return variance, np.maximum(variance - settings.threshold_db2, 0.0), near


def _average(batch: WayBatch) -> NDArray[np.float64]:
    """sum_g w_g c(g)' S^-1 c(g), both with what is not known of theta (theory 4.5)."""
    _, _, across = batch.across
    # tr(S^-1 C C') with C C' small: solving for C itself would cost several times as much.
    gathered = across @ across.transpose(0, 2, 1)
    return np.trace(np.linalg.solve(batch.universal, gathered), axis1=1, axis2=2)


def legs_m(at: Situation, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of the steps of every way, ``(c, N)``."""
    ends = np.concatenate([np.broadcast_to(at.position_m, (len(ways_m), 1, 2)), ways_m], axis=1)
    return np.linalg.norm(np.diff(ends, axis=1), axis=2)
