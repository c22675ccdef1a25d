"""What many ways are worth at once, from the measurements near them all: for choosing among them.

The terms are those of :mod:`planopt.planning.worth.path_worth`, by the same formulae, batched over
ways. One set of measurements serves them all, so that the cost grows neither with their number nor,
by much, with that of the ways. Where the set is all there are, nothing but rounding is between the
two, the largest products being in single precision; what is chosen here is valued again there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import connection_probability
from planopt.channel.kernel import shadow_covariance_db2
from planopt.channel.path_loss import regressors
from planopt.channel.prediction import KrigingTerms, Prediction, combine
from planopt.objectives.energy import expected_transmit_power_w
from planopt.objectives.expression import expression_values
from planopt.objectives.filter_gain import (
    covariance_gain,
    first_steps,
    information_gain,
    sensing_of,
)
from planopt.objectives.local_channel import (
    LocalChannel,
    LocalGrid,
    local_channel,
    local_grid,
)
from planopt.objectives.passage_programme import charged_distances_m
from planopt.objectives.path_loss_learning import theta_information
from planopt.objectives.tracking import tracking_reward
from planopt.planning.search.ways_missing import ways_missing
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

ANCHORS = 64
"""Places among those of all ways that measurements are chosen near to."""

LEAST_NEIGHBOURS, STEP_NEIGHBOURS, MOST_NEIGHBOURS = 96, 16, 384
"""Measurements shared by all ways: so many, so many more for each step, and never more. They cover
all that can be reached, so that they are more than a polish needs about one way: with 128 of 400,
the ways of 20 steps that were chosen lost a tenth of the best worth."""

RANKED_PLACES = 300
"""Of the places where a map is wanted, about so many are looked at, evenly among them."""

NUGGET_SHARE = 1e-4
"""Least variance of multipath as a share of the shadowing's: without any, a place that is measured
twice would make the covariance singular."""


MISSING_DB_SHARE = 10.0
"""What a missing dB costs, in units of the largest worth of the ways first valued."""


class LocalRanking:
    """Values ways of one situation.

    Parameters
    ----------
    situation
        What is known.
    about_m
        ``(c, N, 2)`` ways like those that will be valued: measurements near them are used.
    """

    def __init__(self, situation: Situation, about_m: NDArray[np.float64]) -> None:
        self._situation = situation
        count = min(LEAST_NEIGHBOURS + STEP_NEIGHBOURS * int(about_m.shape[1]), MOST_NEIGHBOURS)
        self._channel = local_channel(situation.posterior, _anchors(about_m), count)
        self._precision = self._channel.precision.astype(np.float32)
        self._missing_db_cost: float | None = None
        self._grid: LocalGrid | None = None
        if any(isinstance(t, MappingTerm) and t.form == "average" for t in situation.problem.terms):
            region = situation.near_region
            every = max(1, round(len(region.weight) / RANKED_PLACES))
            grid, weight = region.grid_m[::every], region.weight[::every]
            self._grid = local_grid(self._channel, grid, every * weight)

    def __call__(self, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Weighted sum of the terms of each way ``(c, N, 2)``, near its exact worth; ``(c,)``.

        Where connectivity is bounded, ways that miss the bound come after all others.
        """
        at, batch = self._situation, _Batches(self._channel, self._precision, ways_m)
        worth = np.zeros(len(ways_m))
        for term in at.problem.terms:
            worth += term.weight * _value(term, at, batch, self._grid)
        if not at.problem.constraints.asks_connection:
            return worth
        if self._missing_db_cost is None:
            self._missing_db_cost = MISSING_DB_SHARE * float(np.abs(worth).max())
        missing = ways_missing(at, _legs_m(at, ways_m), batch.power())
        return worth - self._missing_db_cost * missing


class _Batches:
    """S and B of theory 4.0 for every way.

    Attributes
    ----------
    ways_m
        ``(c, N, 2)``.
    covariance, trend
        ``(c, N, N)`` S as if theta were known, ``(c, N, 2)`` B.
    """

    def __init__(
        self,
        channel: LocalChannel,
        precision: NDArray[np.float32],
        ways_m: NDArray[np.float64],
    ) -> None:
        self.channel, self.ways_m = channel, ways_m
        parameters = channel.parameters
        places = ways_m.reshape(-1, 2)
        self.phi = shadow_covariance_db2(places, channel.positions_m, parameters, channel.blur_m2)
        self.shape: tuple[int, int] = (len(ways_m), len(places) // max(len(ways_m), 1))
        self.single = self.phi.astype(np.float32)
        solved = (self.single @ precision).reshape(*self.shape, -1)
        by_way = self.single.reshape(*self.shape, -1)
        self.covariance = shadow_covariance_db2(ways_m, ways_m, parameters)
        self.covariance -= solved @ by_way.transpose(0, 2, 1)
        own = np.arange(self.shape[1])
        least = NUGGET_SHARE * parameters.shadow_std_db**2
        nugget = max(parameters.multipath_std_db**2, least)
        self.covariance[:, own, own] += nugget
        trend = regressors(places, parameters.station) - self.phi @ channel.trend
        self.trend = trend.reshape(*self.shape, 2)

    def universal(self) -> NDArray[np.float64]:
        """S + B M B', ``(c, N, N)``."""
        pulled = self.trend @ self.channel.theta_covariance
        return self.covariance + pulled @ self.trend.transpose(0, 2, 1)

    def factor(self) -> NDArray[np.float64]:
        """Cholesky factors of :meth:`universal`."""
        return np.asarray(np.linalg.cholesky(self.universal()), dtype=np.float64)

    def power(self) -> Prediction:
        """Prediction at every place, those of a way together; ``(c N,)``."""
        channel = self.channel
        own = np.arange(self.shape[1])
        terms = KrigingTerms(
            self.phi @ channel.weights,
            self.trend.reshape(-1, 2),
            self.covariance[:, own, own].ravel(),
        )
        return combine(terms, channel.theta, channel.theta_covariance)


def _value(
    term: Term, at: Situation, batch: _Batches, grid: LocalGrid | None
) -> NDArray[np.float64]:
    match term:
        case TrackingTerm():
            return _tracking(term, at, batch)
        case LearningTerm():
            return _learning(term, at, batch)
        case MappingTerm():
            return _mapping(term, at, batch, grid)
        case MotionEnergyTerm():
            legs = _legs_m(at, batch.ways_m)
            moving = (legs > STANDSTILL_M).sum(axis=1) * at.problem.planner.step_s
            return -(term.per_metre_j_m * legs.sum(axis=1) + term.power_w * moving)
        case UntilConnectedTerm():
            return _until_connected(term, at, batch)
        case TransmissionEnergyTerm():
            power, radio = batch.power(), at.radio(term)
            each = expected_transmit_power_w(power.mean_db, power.deviation_db, radio)
            return -radio.send_s * each.reshape(batch.shape).sum(axis=1)
        case CasadiTerm():
            return _expression(term, at, batch)


def _tracking(term: TrackingTerm, at: Situation, batch: _Batches) -> NDArray[np.float64]:
    settings = at.tracking(term)
    power = batch.power()
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
    term: UntilConnectedTerm, at: Situation, batch: _Batches
) -> NDArray[np.float64]:
    settings = at.search(term)
    above = batch.power().mean_db.reshape(batch.shape) - settings.threshold_dbm
    legs = _legs_m(at, batch.ways_m)
    return -charged_distances_m(above, batch.universal(), legs, settings.beyond_m)


def _expression(term: CasadiTerm, at: Situation, batch: _Batches) -> NDArray[np.float64]:
    """Ways for which the expression has no finite value come last."""
    power = batch.power()
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


def _learning(term: LearningTerm, at: Situation, batch: _Batches) -> NDArray[np.float64]:
    criterion = at.criterion(term)
    whitened = np.linalg.solve(batch.covariance, batch.trend)
    gained = batch.trend.transpose(0, 2, 1) @ whitened
    before = None if criterion.kind == "T" else theta_information(at.posterior)
    return criterion.value(gained, before) - criterion.value(np.zeros((2, 2)), before)


def _mapping(
    term: MappingTerm, at: Situation, batch: _Batches, grid: LocalGrid | None
) -> NDArray[np.float64]:
    match term.form:
        case "two_layer":
            if at.steering_m is None:
                return np.zeros(batch.shape[0])
            start = float(np.linalg.norm(at.position_m - at.steering_m))
            return (start - np.linalg.norm(batch.ways_m - at.steering_m, axis=2)).sum(axis=1)
        case "path":
            settings = at.uncertainty(term)
            variance = np.diagonal(batch.factor(), axis1=1, axis2=2) ** 2
            near = np.exp(-settings.decay_per_m * np.cumsum(_legs_m(at, batch.ways_m), axis=1))
            return (np.maximum(variance - settings.threshold_db2, 0.0) * near).sum(axis=1)
        case "information":
            diagonal = np.diagonal(batch.factor(), axis1=1, axis2=2)
            return np.log(diagonal / batch.channel.parameters.multipath_std_db).sum(axis=1)
        case "average":
            if grid is None:
                raise AssertionError("the spatial average needs a grid")
            return _average(batch, grid)


def _average(batch: _Batches, grid: LocalGrid) -> NDArray[np.float64]:
    """sum_g w_g c(g)' S^-1 c(g), both with what is not known of theta (theory 4.5)."""
    channel = batch.channel
    places = batch.ways_m.reshape(-1, 2)
    across = shadow_covariance_db2(places, grid.positions_m, channel.parameters)
    across -= batch.single @ grid.solved.astype(np.float32)
    across += batch.trend.reshape(-1, 2) @ (channel.theta_covariance @ grid.trend.T)
    across *= grid.root_weight
    across = across.reshape(*batch.shape, -1)
    # tr(S^-1 C C') with C C' small: solving for C itself would cost several times as much.
    gathered = across @ across.transpose(0, 2, 1)
    return np.trace(np.linalg.solve(batch.universal(), gathered), axis1=1, axis2=2)


def _legs_m(at: Situation, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of the steps of every way, ``(c, N)``."""
    ends = np.concatenate([np.broadcast_to(at.position_m, (len(ways_m), 1, 2)), ways_m], axis=1)
    return np.linalg.norm(np.diff(ends, axis=1), axis=2)


def _anchors(ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Up to `ANCHORS` of the ways' places, evenly among them; (a, 2)."""
    places = ways_m.reshape(-1, 2)
    return places[np.linspace(0, len(places) - 1, min(ANCHORS, len(places))).astype(np.intp)]
