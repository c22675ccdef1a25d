"""Each term of the objective, of many ways at once: the formulae of its own file, batched."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, connection_probability
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
from planopt.objectives.until_connected import NOT_TRIED_DB
from planopt.planning.search.told_batch import ToldBatch
from planopt.planning.search.way_batch import WayBatch
from planopt.planning.tolerances import STANDSTILL_M
from planopt.planning.worth.expression_inputs import known_inputs
from planopt.planning.worth.link_energy import link_energy_j
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


@dataclass(frozen=True, eq=False)
class RankedWays:
    """Many ways, and what is predicted along them.

    Attributes
    ----------
    at
        What is known.
    ways_m
        ``(c, N, 2)``.
    stations
        Each station's power along all of them.
    told
        What measurements of it along them tell.
    """

    at: Situation
    ways_m: NDArray[np.float64]
    stations: Sequence[WayBatch]
    told: Sequence[ToldBatch]

    @property
    def shape(self) -> tuple[int, int]:
        """How many ways, and of how many steps."""
        return self.stations[0].shape

    @cached_property
    def each(self) -> list[Prediction]:
        """Each station's power at every place, those of a way together; ``(c N,)``."""
        return [batch.power for batch in self.stations]

    @cached_property
    def power(self) -> Prediction:
        """What connectivity rests on at every place; ``(c N,)``."""
        return self.at.law(self.each)

    @cached_property
    def chance(self) -> NDArray[np.float64]:
        """Probability of a connection after every step; ``(c, N)``."""
        threshold = self.at.problem.stations[0].threshold_dbm
        found = connection_probability(self.power.mean_db, self.power.deviation_db, threshold)
        return found.reshape(self.shape)

    @cached_property
    def legs_m(self) -> NDArray[np.float64]:
        """Lengths of the steps of every way, ``(c, N)``."""
        return legs_m(self.at, self.ways_m)


def ranked_value(term: Term, ways: RankedWays) -> NDArray[np.float64]:
    """What `term` is worth of each way, ``(c,)``."""
    at = ways.at
    match term:
        case TrackingTerm():
            return _tracking(term, ways)
        case LearningTerm():
            return _added(
                _learning(term, at, told, station)
                for told, station in zip(ways.told, at.stations, strict=True)
            )
        case MappingTerm():
            return _mapping(term, ways)
        case MotionEnergyTerm():
            moving = (ways.legs_m > STANDSTILL_M).sum(axis=1) * at.problem.planner.step_s
            return -(term.per_metre_j_m * ways.legs_m.sum(axis=1) + term.power_w * moving)
        case UntilConnectedTerm():
            return _until_connected(term, ways)
        case TransmissionEnergyTerm():
            return -link_energy_j(term, at, ways.each).reshape(ways.shape).sum(axis=1)
        case CasadiTerm():
            return _expression(term, ways)
        case _:
            raise AssertionError(f"{term.kind} has no value here")


def _added(parts: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The sum over stations: what measurements of independent ones tell adds up."""
    first, *others = parts
    for other in others:
        first = first + other
    return first


def _tracking(term: TrackingTerm, ways: RankedWays) -> NDArray[np.float64]:
    settings, chance = ways.at.tracking(term), ways.chance
    if term.form != "additive":
        filtered = first_steps(ways.at.filtered(term), ways.shape[1])
        # Sampling joint losses of every way would be dear: what is chosen is sampled afterwards.
        gain = information_gain if term.form == "information" else covariance_gain
        return gain(chance, sensing_of(ways.ways_m, filtered), filtered)
    return np.sum(
        [
            tracking_reward(chance[:, k], ways.ways_m[:, k], k, settings)
            for k in range(ways.shape[1])
        ],
        axis=0,
    )


def _until_connected(term: UntilConnectedTerm, ways: RankedWays) -> NDArray[np.float64]:
    settings = ways.at.search(term)
    missing_db = np.where(ways.at.tries.takes(ways.ways_m), 0.0, NOT_TRIED_DB)
    (above, covariance), *further = [
        (power.mean_db.reshape(ways.shape) - threshold - missing_db, batch.universal)
        for power, batch, threshold in zip(
            ways.each, ways.stations, settings.thresholds_dbm, strict=True
        )
    ]
    beyond = ways.at.beyond_m(term, ways.ways_m[:, -1])
    return -charged_distances_m(above, covariance, ways.legs_m, beyond, further)


def _expression(term: CasadiTerm, ways: RankedWays) -> NDArray[np.float64]:
    """Ways for which the expression has no finite value come last."""
    known = known_inputs(term, ways.at, ways.shape[1])
    given = {"positions_m": ways.ways_m} | {
        name: np.broadcast_to(values, (ways.shape[0], *values.shape))
        for name, values in known.items()
    }
    for name, values in (
        ("mean_db", ways.power.mean_db),
        ("deviation_db", ways.power.deviation_db),
        ("connectivity", ways.chance),
    ):
        given[name] = values.reshape(*ways.shape, 1)
    found = expression_values(term.program, term.steps, given)
    return np.where(np.isfinite(found), found, -np.inf)


def _learning(
    term: LearningTerm, at: Situation, told: ToldBatch, station: ChannelPosterior
) -> NDArray[np.float64]:
    criterion = at.criterion(term, station)
    whitened = np.linalg.solve(told.covariance, told.trend)
    gained = told.trend.transpose(0, 2, 1) @ whitened
    before = None if criterion.kind == "T" else theta_information(station)
    return criterion.value(gained, before) - criterion.value(np.zeros((2, 2)), before)


def _mapping(term: MappingTerm, ways: RankedWays) -> NDArray[np.float64]:
    at = ways.at
    if term.form != "two_layer":
        return _added(_mapped(term, at, told) for told in ways.told)
    if at.steering is None:
        return np.zeros(ways.shape[0])
    return at.steering.gained_m(ways.ways_m)


def _mapped(term: MappingTerm, at: Situation, told: ToldBatch) -> NDArray[np.float64]:
    """What the measurements of one station tell."""
    if term.form == "path":
        excess, near = path_form_parts(term, at, told)
        return (excess * near).sum(axis=1)
    if term.form == "information":
        diagonal = np.diagonal(told.factor, axis1=1, axis2=2)
        return np.log(diagonal / np.sqrt(told.noise_db2)).sum(axis=1)
    return _average(told)


def path_form_parts(
    term: MappingTerm, at: Situation, told: ToldBatch
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What of L_ii^2 is above the threshold, and psi of the way there; each ``(c, N)``."""
    settings = at.uncertainty(term)
    length = np.cumsum(legs_m(at, told.batch.ways_m), axis=1)
    return told.above_db2(settings.threshold_db2), np.exp(-settings.decay_per_m * length)


def _average(told: ToldBatch) -> NDArray[np.float64]:
    """Return sum_g w_g c(g)' S^-1 c(g), theta's uncertainty counted (equation 4.6)."""
    across = told.across
    # tr(S^-1 C C') with C C' small: solving for C itself would cost several times as much.
    gathered = across @ across.transpose(0, 2, 1)
    return np.trace(np.linalg.solve(told.universal, gathered), axis1=1, axis2=2)


def legs_m(at: Situation, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of the steps of every way, ``(c, N)``."""
    ends = np.concatenate([np.broadcast_to(at.position_m, (len(ways_m), 1, 2)), ways_m], axis=1)
    return np.linalg.norm(np.diff(ends, axis=1), axis=2)
