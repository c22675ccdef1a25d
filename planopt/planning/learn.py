"""Beliefs of a run: fitted to the first measurements, and updated with those of each step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from planopt.channel.belief import Belief, update
from planopt.channel.cholesky import one_blas_thread
from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.fit import fit_channel
from planopt.channel.ground_truth import Truth
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import PRIOR_N_PL, ChannelParameters
from planopt.channel.posterior import ChannelPosterior, condition
from planopt.objectives.measuring import MeasuringRule
from planopt.planning.initial_data import draw_initial_data
from planopt.problems.channel_setup import GivenParameters
from planopt.problems.problem import Problem


def learn(problem: Problem, measurements: Measurements, station: int = 0) -> Belief:
    """Fit the channel of one of the problem's stations to measurements and condition on them."""
    site = problem.stations[station].site
    if problem.channel.given is not None:
        fit, posterior = _given(problem, problem.channel.given, measurements, station)
    else:
        fit = fit_channel(measurements, site, problem.channel.fit_method)
        posterior = condition(fit.parameters, measurements)
    return Belief(fit, posterior)


def _given(
    problem: Problem, known: GivenParameters, measurements: Measurements, station: int
) -> tuple[ChannelFit, ChannelPosterior]:
    """Condition on measurements with known parameters; unknown path loss is estimated."""
    radio = problem.stations[station]
    path_loss_known = known.k_pl_db is not None
    parameters = ChannelParameters(
        k_pl_db=(known.k_pl_db or 0.0) + radio.transmit_power_dbm,
        n_pl=PRIOR_N_PL if known.n_pl is None else known.n_pl,
        shadow_std_db=known.shadow_std_db,
        decorrelation_m=known.decorrelation_m,
        multipath_std_db=known.multipath_std_db,
        station=radio.site,
    )
    posterior = condition(
        parameters, measurements, theta="known" if path_loss_known else "estimated"
    )
    if not path_loss_known:
        theta = posterior.theta
        parameters = replace(parameters, k_pl_db=float(theta[0]), n_pl=float(theta[1]))
        posterior = condition(parameters, measurements)
    errors = dict.fromkeys((each.name for each in fields(known)), 0.0)
    deviation = np.sqrt(np.diag(posterior.theta_covariance))
    errors |= {"k_pl_db": float(deviation[0]), "n_pl": float(deviation[1])}
    fit = ChannelFit(
        method="given",
        status="ok",
        parameters=parameters,
        standard_errors=errors,
        theta_covariance=posterior.theta_covariance,
        measurements=len(measurements),
        censored=int(measurements.censored.sum()),
        warnings=(),
        log_likelihood=None,
    )
    return fit, posterior


def learn_stations(problem: Problem, measurements: Sequence[Measurements]) -> Belief:
    """Fit the channel of every station to its first measurements."""
    beliefs = [learn(problem, own, station) for station, own in enumerate(measurements)]
    return replace(beliefs[0], further=tuple(beliefs[1:]))


@dataclass(frozen=True)
class Prepared:
    """Ground truth by station, and the initial belief, of one seed."""

    truths: tuple[Truth, ...]  # Empty if the problem has none
    belief: Belief


@one_blas_thread()
def prepare(
    problem: Problem, seed: int, measurements: Sequence[Measurements] | None = None
) -> Prepared:
    """Draw the initial data and fit the channel to the first measurements."""
    data = draw_initial_data(problem, seed, measurements)
    return Prepared(data.truths, learn_stations(problem, data.measurements))


def learn_measured(problem: Problem, belief: Belief, measured: Sequence[Measurements]) -> Belief:
    """Add measurements of each station to a belief, except those nearer than the spacing."""
    if not any(len(each) for each in measured):
        return belief
    rule = MeasuringRule.of(belief.posteriors, problem.channel.measure_spacing_m)
    taken = [each.take(rule.takes(each.positions_m)) for each in measured]
    return update(belief, *taken) if any(map(len, taken)) else belief
